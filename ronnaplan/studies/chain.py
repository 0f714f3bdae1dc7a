"""The chain study: from the CT scan of a phantom to a target in the robot's frame, and who contributes what error.

Scans are rendered, written, read and localized. Tracker, tool and robot are simulated with stated errors and go
through the same pairing, registration, tool recognition and chain as real data. The error at the targets in R is
compared with the covariance that the chain predicted for it.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ronnaplan.geometry import FloatArray, Frame, Points
from ronnaplan.pose import Pose
from ronnaplan.registration import Registration
from ronnaplan.registration.marker_registration import register_markers
from ronnaplan.robot.chain import OTS, TCP, Capture, M, R, robot_from_ct
from ronnaplan.robot.recorded import locate_tool
from ronnaplan.studies.blocks import Record, run_blocks, write_whole
from ronnaplan.transforms import about, exponential, invert, rigid, transform_points

SCANS = 6
"""Simulated scans, each with its own sessions."""
CT_SPACING_MM, CT_MATRIX, CT_NOISE_HU = 1.25, 320, 25.0
"""A quick, noisy scan: what CT contributes should be seen."""
TRACKER_SD_MM = np.array([0.10, 0.10, 0.22])
"""One marker reading along the tracker's x, y and z (depth): 0.26 mm RMS, the published figure."""
CALIBRATION_SD = np.repeat([np.radians(0.03), 0.10], 3)
"""M from TCP: rad and mm per axis, about the tool's tip."""
ROBOT_SD = np.repeat([np.radians(0.01), 0.03], 3)
"""R from TCP: rad and mm per axis, about the TCP."""
M_SPHERES_MM = np.array([[0.0, 60, 0], [45, 0, 0], [0, -75, 0], [-90, 0, 0]])
GEOMETRY_SD_MM = 0.01
"""How well the tool's own geometry is known."""
TARGETS_MM = np.array([[0.0, 0, 0], [12, -5, -8], [-25, 20, 10], [30, -40, 25], [0, 10, -35]])
"""Deep structures of the phantom's head, LPS mm about its center."""
SOURCES = ("CT localization", "tracker: head markers", "tracker: tool markers", "tool calibration", "robot")


@dataclass(frozen=True)
class LocalizedPhantom:
    """One localized scan: what was found, and the truth, row by row."""

    found: Points
    truth_mm: FloatArray


def scan_phantom(seed: int) -> LocalizedPhantom:
    """Render the laboratory phantom with noise ``seed``, write and read it as DICOM, localize its markers."""
    from phantoms.fast import render
    from phantoms.library import laboratory_phantom
    from phantoms.output import write_phantom
    from phantoms.stack import axial_stack
    from ronnaplan.ct import read_ct
    from ronnaplan.localization import localize

    scene = laboratory_phantom()
    truth = np.array([marker.center_mm for marker in scene.markers])
    low, high = float(truth[:, 2].min()) - 15, float(truth[:, 2].max()) + 15
    stack = axial_stack(
        start_mm=low, stop_mm=high, spacing_mm=CT_SPACING_MM, matrix=CT_MATRIX, field_of_view_mm=280.0
    )
    with tempfile.TemporaryDirectory() as folder:
        images = render(scene, stack, noise_hu=CT_NOISE_HU, seed=seed)
        write_phantom(Path(folder) / "ct", scene, stack, images)
        found = localize(read_ct(Path(folder) / "ct"), diameter_mm=11.5, expected=len(truth)).points
    nearest = np.linalg.norm(found.positions_mm[:, None] - truth, axis=2).argmin(axis=1)
    return LocalizedPhantom(found, truth[nearest])


def run_block(scan: int, trials: int, seed: int) -> Record:
    """Return sums over ``trials`` sessions with all errors, and over as many with each source's error alone."""
    ct = scan_phantom(seed + scan)
    record: Record = {}
    for number, only in enumerate((None, *SOURCES)):
        rng = np.random.default_rng([seed, scan, number])
        active = SOURCES if only is None else (only,)
        sessions = [simulate_session(rng, ct, active) for _ in range(trials)]
        answered = [one for one in sessions if one is not None]
        record[only or "all"] = {
            "refused": trials - len(answered),
            "squared_mm2": [float((error**2).sum(axis=1).mean()) for error, _, _ in answered],
        }
        if only is None:
            record["all"]["predicted_mm2"] = [_predicted(head, capture) for _, head, capture in answered]
    return record


def simulate_session(
    rng: np.random.Generator, scan: LocalizedPhantom, active: tuple[str, ...]
) -> tuple[FloatArray, Registration, Capture] | None:
    """Simulate one session in which only ``active`` sources err; None when pairing or tool are refused.

    Returns the error (T, 3) in R at the targets, the head's registration, and what the tool was seen by.
    """
    truth = _world(rng)
    ct_mm = scan.found.positions_mm if SOURCES[0] in active else scan.truth_mm
    ct = Points(ct_mm, scan.found.covariances_mm2, scan.found.labels, scan.found.frame)
    seen = transform_points(truth.ots_from_ct, scan.truth_mm)
    head = register_markers(ct, _read(rng, seen, SOURCES[1] in active), expected=len(ct), sigma_ct_mm=0.0)
    spheres = transform_points(truth.ots_from_m, M_SPHERES_MM)
    geometry = Points(M_SPHERES_MM, np.tile(GEOMETRY_SD_MM**2 * np.eye(3), (4, 1, 1)), tuple("1234"), M)
    tool = locate_tool(geometry, _read(rng, spheres, SOURCES[2] in active), expected=4)
    if head.registration is None or tool.registration is None:
        return None
    m_from_tcp = _uncertain(rng, truth.m_from_tcp, CALIBRATION_SD, SOURCES[3] in active, M)
    robot_from_tcp = _uncertain(rng, truth.robot_from_tcp, ROBOT_SD, SOURCES[4] in active, R)
    capture = Capture(tool.registration.pose, m_from_tcp, robot_from_tcp)
    chain = robot_from_ct(head.registration.pose, capture)
    error = chain.apply(TARGETS_MM) - transform_points(truth.robot_from_ct, TARGETS_MM)
    return error, head.registration, capture


@dataclass(frozen=True)
class _World:
    """The true poses (4, 4) of one session."""

    ots_from_ct: FloatArray
    ots_from_m: FloatArray
    m_from_tcp: FloatArray
    robot_from_tcp: FloatArray

    @property
    def robot_from_ct(self) -> FloatArray:
        ots_from_tcp = self.ots_from_m @ self.m_from_tcp
        matrix: FloatArray = self.robot_from_tcp @ invert(ots_from_tcp) @ self.ots_from_ct
        return matrix


def _world(rng: np.random.Generator) -> _World:
    """Return a head 1.5 m before the tracker, and a tool whose tip is about 200 mm beside it, turned at random."""
    place = np.array([0, 0, -1500.0])
    head = rigid(_turn(rng), place + rng.uniform(-100, 100, 3))
    tool = rigid(_turn(rng), place + np.array([200.0, 0, 0]) + rng.uniform(-50, 50, 3))
    return _World(
        head, tool, rigid(_turn(rng), np.array([-15.0, 30, 180])), rigid(_turn(rng), np.array([700.0, 0, 400]))
    )


def _turn(rng: np.random.Generator) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.random(rng=rng).as_matrix())


def _read(rng: np.random.Generator, true_mm: FloatArray, noisy: bool) -> Points:
    """Return the tracker's readings of markers at ``true_mm`` (N, 3), in any order."""
    order = rng.permutation(len(true_mm))
    noise = rng.normal(size=true_mm.shape) * TRACKER_SD_MM * noisy
    covariances = np.tile(np.diag(TRACKER_SD_MM**2), (len(true_mm), 1, 1))
    return Points((true_mm + noise)[order], covariances, tuple(str(k + 1) for k in range(len(order))), OTS)


def _uncertain(rng: np.random.Generator, matrix: FloatArray, sd: FloatArray, noisy: bool, to: Frame) -> Pose:
    """Return ``to`` from TCP with errors of standard deviation ``sd`` (6,) about the TCP, in ``to``'s axes."""
    tip = rigid(np.eye(3), matrix[:3, 3])
    xi = rng.normal(size=6) * sd * noisy
    moved = tip @ rigid(exponential(xi[:3]), xi[3:]) @ invert(tip) @ matrix
    carry = about(-matrix[:3, 3])
    return Pose(moved, carry @ np.diag(sd**2) @ carry.T, to, TCP)


def _predicted(head: Registration, capture: Capture) -> list[float]:
    """Return the predicted mean square error (mm^2) at the targets that each of `SOURCES` brings."""
    exact = [Pose.exact(pose.matrix, pose.to_frame, pose.from_frame) for pose in
             (capture.ots_from_m, capture.m_from_tcp, capture.robot_from_tcp)]  # fmt: skip
    poses = [capture.ots_from_m, capture.m_from_tcp, capture.robot_from_tcp]
    still = Pose.exact(head.transform, head.pose.to_frame, head.pose.from_frame)
    ct, readings = _shares(head)
    parts = []
    for covariance in (ct, readings):
        pose = Pose(head.transform, covariance, head.pose.to_frame, head.pose.from_frame)
        parts.append(robot_from_ct(pose, Capture(*exact)))
    for k in range(3):
        links = [poses[i] if i == k else exact[i] for i in range(3)]
        parts.append(robot_from_ct(still, Capture(*links)))
    return [float(np.trace(part.point_covariances(TARGETS_MM), axis1=1, axis2=2).mean()) for part in parts]


def _shares(registration: Registration) -> tuple[FloatArray, FloatArray]:
    """Return the parts of a registration's covariance (6, 6) that the moving and the fixed points bring.

    To first order they add up to nearly all of it; what is beyond is shared between them in proportion.
    """
    assert registration.stated_mm2 is not None
    rotation = registration.pose.rotation
    gain = registration.gain
    sides = (rotation @ registration.stated_mm2[0] @ rotation.T, registration.stated_mm2[1])
    moving, fixed = ((gain @ side @ gain.transpose(0, 2, 1)).sum(axis=0) for side in sides)
    whole = np.linalg.cholesky(registration.pose.covariance) @ np.linalg.inv(np.linalg.cholesky(moving + fixed))
    return whole @ moving @ whole.T, whole @ fixed @ whole.T


def run_chain(
    folder: Path, trials: int, seed: int, *, workers: int | None = None, scheduler: str | None = None
) -> list[Record]:
    """Run the study into ``folder``: journal, results.json, table.md. ``trials`` sessions a scan and source."""
    settings = {"study": "chain", "trials": trials, "seed": seed}
    blocks = [(scan, trials, seed) for scan in range(SCANS)]
    journal = folder / "journal.jsonl"
    records = run_blocks(run_block, blocks, journal, settings, workers=workers, scheduler=scheduler, label="chain")
    rows = summarize(records)
    write_whole(folder / "results.json", json.dumps({**settings, "sources": rows}, indent=1) + "\n")
    write_whole(folder / "table.md", chain_table(rows))
    return rows


def summarize(records: list[Record]) -> list[Record]:
    """Return predicted and observed RMS error (mm) of each source alone and of all together, and refusals."""
    rows = []
    for number, source in enumerate((*SOURCES, "all")):
        squared = np.concatenate([record[source]["squared_mm2"] for record in records])
        predicted = np.concatenate([np.array(record["all"]["predicted_mm2"]).reshape(-1, 5) for record in records])
        mean = predicted.mean(axis=0)
        here = float(mean.sum() if source == "all" else mean[number])
        rows.append(
            {
                "source": source,
                "predicted_rms_mm": float(np.sqrt(here)),
                "observed_rms_mm": float(np.sqrt(squared.mean())),
                "share": here / float(mean.sum()),
                "refused": sum(record[source]["refused"] for record in records),
                "sessions": len(squared),
            }
        )
    return rows


def chain_table(rows: list[Record]) -> str:
    """Return the error budget as Markdown."""
    lines = ["| source | predicted, mm RMS | observed alone | ratio | share of variance | sessions | refused |"]
    lines.append("|---|---|---|---|---|---|---|")
    for row in rows:
        ratio = row["observed_rms_mm"] / row["predicted_rms_mm"]
        lines.append(
            f"| {row['source']} | {row['predicted_rms_mm']:.3f} | {row['observed_rms_mm']:.3f} | {ratio:.3f} "
            f"| {100 * row['share']:.1f} % | {row['sessions']} | {row['refused']} |"
        )
    return "\n".join([*lines, ""])
