"""The tracking study: 17 CT scans of the x-shaped frame x 1,415 tracker readings (section 4.3, Figs. 8 and 9)."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_OTS_MM
from ronnaplan.studies.blocks import Record, run_blocks, write_whole
from ronnaplan.studies.heads import X_FRAME_MM
from ronnaplan.studies.scenes import random_rotations

PHANTOM_SCANS, PATIENT_SCANS, READINGS = 5, 12, 1415

DISTANCE_SD_MM = {"phantom": 0.14, "patient": 0.56}
"""Standard deviation of a distance between two markers in CT.  A normal error of this size has the published mean
absolute error (0.11 and 0.44 mm); per axis and marker it is this over the square root of two."""

TOLERANCES_MM: FloatArray = np.round(np.arange(1.0, 6.05, 0.1), 1)


def scan_kind(scan: int) -> str:
    """Return whether a scan is of the phantom or of a patient."""
    return "phantom" if scan < PHANTOM_SCANS else "patient"


def simulate_scan(scan: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return the four markers of one scan, (4, 3) in CT, and the readings of them, (1415, 4, 3) in OTS.

    The readings are the same for every scan: the frame is moved all over a working volume of 1.5 m.
    """
    noise = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, scan)))
    sigma_ct = DISTANCE_SD_MM[scan_kind(scan)] / math.sqrt(2.0)
    ct = X_FRAME_MM + sigma_ct * noise.standard_normal(X_FRAME_MM.shape)
    moving = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    placed = np.einsum("tab,nb->tna", random_rotations(moving, READINGS), X_FRAME_MM)
    placed += moving.uniform(-750.0, 750.0, (READINGS, 1, 3)) + np.array([0.0, 0.0, -1800.0])
    return ct, placed + SIGMA_OTS_MM * moving.standard_normal(placed.shape)


def run_scan(scan: int, seed: int) -> Record:
    """Pair one scan with every reading, by the published algorithm for each e alone and by the exact matcher once.

    Returns counts of right, refused and wrong answers.  The points of a reading are shuffled first.
    """
    from ronnaplan.correspondence import match_points
    from ronnaplan.correspondence.similarity import similarity_match_many
    from ronnaplan.studies.judging import outcomes

    ct, readings = simulate_scan(scan, seed)
    shuffle = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2, scan)))
    order = np.argsort(shuffle.random(readings.shape[:2]), axis=1)
    readings = np.take_along_axis(readings, order[:, :, None], axis=1)
    truth = np.argsort(order, axis=1)
    repeated = np.broadcast_to(ct, readings.shape).copy()
    published = []
    for e in TOLERANCES_MM:
        partner = similarity_match_many(repeated, readings, len(ct), e, e, 1.0, True)
        published.append(outcomes(partner, truth))
    sigma_ct = DISTANCE_SD_MM[scan_kind(scan)] / math.sqrt(2.0)
    given = np.full(truth.shape, -1)
    for index, reading in enumerate(readings):
        answer = match_points(ct, reading, len(ct), sigma_ct, SIGMA_OTS_MM)
        given[index, answer.pairs[:, 0]] = answer.pairs[:, 1]
    return {"published": published, "exact": outcomes(given, truth)}


def run_tracking(
    folder: Path, seed: int, *, workers: int | None = None, scheduler: str | None = None
) -> list[Record]:
    """Run the study into ``folder``: journal, results.json, table.md, plots in the form of Figs. 8 and 9."""
    from ronnaplan.studies.plots import plot_tracking

    scans = range(PHANTOM_SCANS + PATIENT_SCANS)
    settings = {"study": "tracking", "readings": READINGS, "seed": seed}
    records = run_blocks(
        run_scan,
        [(scan, seed) for scan in scans],
        folder / "journal.jsonl",
        settings,
        workers=workers,
        scheduler=scheduler,
        label="tracking",
    )
    results = [
        {"scan": scan, "kind": scan_kind(scan), **record} for scan, record in zip(scans, records, strict=True)
    ]
    document = {**settings, "tolerances_mm": TOLERANCES_MM.tolist(), "scans": results}
    write_whole(folder / "results.json", json.dumps(document, indent=1) + "\n")
    write_whole(folder / "table.md", tracking_table(results))
    for kind in DISTANCE_SD_MM:
        chosen = [one["published"] for one in results if one["kind"] == kind]
        plot_tracking(np.array(chosen), TOLERANCES_MM, kind, folder / f"tracking_{kind}.png")
    return results


def tracking_table(results: list[Record]) -> str:
    """Return the range of e in which every pairing succeeds, and the exact matcher's outcomes, as Markdown."""
    lines = ["| scans | pairings | published all right for e | published wrong | exact right | refused | wrong |"]
    lines.append("|---|---|---|---|---|---|---|")
    for kind in DISTANCE_SD_MM:
        chosen = [one for one in results if one["kind"] == kind]
        published, exact = (
            np.array([one["published"] for one in chosen]),
            np.array([one["exact"] for one in chosen]),
        )
        whole = TOLERANCES_MM[(published[:, :, 0] == READINGS).all(axis=0)]
        span = f"{whole.min():.1f} to {whole.max():.1f} mm" if len(whole) else "none"
        right, refused, wrong = exact.sum(axis=0)
        lines.append(
            f"| {kind} | {READINGS * len(chosen)} | {span} | {published[:, :, 2].sum()} "
            f"| {right} | {refused} | {wrong} |"
        )
    return "\n".join([*lines, ""])
