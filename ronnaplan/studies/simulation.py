"""The simulation study: the paper's 900,000 tests (section 4.2, Fig. 7), and tests beyond its protocol."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.studies.blocks import Record, run_blocks, write_whole
from ronnaplan.studies.heads import HEADS_MM
from ronnaplan.studies.scenes import Scenes, simulate_scenes

BLOCK_TESTS = 1000
STRICT_PROBABILITY = 0.9999
PROBABILITY_EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999, 0.9999, 0.99999, 1.0)
"""Bins of stated probability for the calibration table."""


@dataclass(frozen=True, order=True)
class Cell:
    """One condition: ``markers`` on head ``head`` and ``outliers`` in both sets.

    ``hidden`` markers are missing from the tracker's set; ``expected`` is what the matcher is told (0: nothing);
    the true errors are ``noise_percent`` of the stated ones.
    """

    head: int
    markers: int
    outliers: int
    hidden: int = 0
    expected: int = 0
    noise_percent: int = 100


def protocol_cells() -> list[Cell]:
    """Return the paper's 90 cells: 3 heads, 3 to 8 markers, 0 to 4 outliers."""
    return [Cell(h, f, o, expected=f) for f in range(3, 9) for o in range(5) for h in range(len(HEADS_MM))]


def further_cells() -> list[Cell]:
    """Return the cells beyond the protocol: wrong errors, hidden markers, unknown and wrong expected numbers."""
    heads, counts = range(len(HEADS_MM)), (3, 4, 5, 8)
    wrong_errors = [Cell(h, f, 2, expected=f, noise_percent=n) for n in (50, 200) for f in counts for h in heads]
    unknown = [Cell(h, f, 2) for f in counts for h in heads]
    hidden = [
        Cell(h, 8, o, hidden=k, expected=e) for k in (1, 2) for o in (0, 2, 4) for e in (0, 8 - k) for h in heads
    ]
    wrong_number = [Cell(h, 6, 2, expected=e) for e in (5, 7) for h in heads]
    return wrong_errors + unknown + hidden + wrong_number


def run_block(
    head: int,
    markers: int,
    outliers: int,
    hidden: int,
    expected: int,
    noise_percent: int,
    index: int,
    tests: int,
    seed: int,
) -> Record:
    """Run ``tests`` tests of one cell and count the outcomes of both algorithms."""
    rng = np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(head, markers, outliers, hidden, noise_percent, index))
    )
    scenes = simulate_scenes(
        rng, HEADS_MM[head], tests, markers, outliers, hidden=hidden, noise=noise_percent / 100.0
    )
    record = judge_exact(scenes, expected or None)
    record["published"] = judge_published(scenes, expected or markers - hidden)
    return record


def judge_exact(scenes: Scenes, expected: int | None) -> Record:
    """Return the outcomes of the exact matcher at both levels of acceptance, and its calibration."""
    from ronnaplan.correspondence.evidence import size_priors
    from ronnaplan.correspondence.exact import match_many
    from ronnaplan.correspondence.matching import LEAST_PROBABILITY

    spread_mm = 60.0
    counts = (scenes.ct.shape[1], scenes.ots.shape[1])
    constants, background = size_priors(counts, expected)
    variance = SIGMA_CT_MM**2 + SIGMA_OTS_MM**2
    partner, probability = match_many(scenes.ct, scenes.ots, variance, constants, background, spread_mm)
    right = (partner == scenes.partner).all(axis=1)
    offered = (partner >= 0).sum(axis=1) == expected if expected else np.ones(len(right), dtype=bool)
    return {
        "exact": outcomes(offered & (probability >= LEAST_PROBABILITY), right),
        "strict": outcomes(offered & (probability >= STRICT_PROBABILITY), right),
        "calibration": calibration(probability, right),
    }


def judge_published(scenes: Scenes, expected: int) -> list[int]:
    """Return the outcomes of the published algorithm, e from 1 to 6 mm by 0.1 mm."""
    from ronnaplan.correspondence.similarity import similarity_match_many

    partner = similarity_match_many(scenes.ct, scenes.ots, expected, 1.0, 6.0, 0.1)
    return outcomes((partner >= 0).any(axis=1), (partner == scenes.partner).all(axis=1))


def outcomes(accepted: NDArray[np.bool_], right: NDArray[np.bool_]) -> list[int]:
    """Return the numbers of right, refused and wrong answers."""
    return [int((accepted & right).sum()), int((~accepted).sum()), int((accepted & ~right).sum())]


def calibration(probability: FloatArray, right: NDArray[np.bool_]) -> list[list[float]]:
    """Return for each bin of stated probability: answers, right answers, sum of the stated probabilities."""
    bins = np.digitize(probability, PROBABILITY_EDGES[1:-1])
    count = len(PROBABILITY_EDGES) - 1
    sums = [np.bincount(bins, weights, count) for weights in (np.ones(len(bins)), right, probability)]
    return [[float(value) for value in row] for row in np.column_stack(sums)]


def run_simulation(
    folder: Path,
    tests: int = 10_000,
    seed: int = 2018,
    *,
    further: bool = True,
    workers: int | None = None,
    scheduler: str | None = None,
) -> dict[Cell, Record]:
    """Run the study of ``tests`` tests a cell, resumably, into ``folder``: journal, results.json, table.md, plots.

    ``further``: also the cells beyond the paper's protocol.  Returns the record of each cell.
    """
    from ronnaplan.studies.plots import plot_calibration, plot_outcomes

    cells = protocol_cells() + (further_cells() if further else [])
    blocks = [
        (*asdict(cell).values(), index, min(BLOCK_TESTS, tests - start), seed)
        for cell in cells
        for index, start in enumerate(range(0, tests, BLOCK_TESTS))
    ]
    settings = {"study": "simulation", "tests": tests, "seed": seed}
    journal = folder / "journal.jsonl"
    records = run_blocks(
        run_block, blocks, journal, settings, workers=workers, scheduler=scheduler, label="simulation"
    )
    by_cell: dict[Cell, Record] = {}
    for block, record in zip(blocks, records, strict=True):
        cell = Cell(*block[:6])
        by_cell[cell] = add(by_cell[cell], record) if cell in by_cell else record
    results = [{**asdict(cell), **record} for cell, record in by_cell.items()]
    write_whole(folder / "results.json", json.dumps({**settings, "cells": results}, indent=1) + "\n")
    write_whole(folder / "table.md", tables(by_cell))
    plot_outcomes(by_cell, folder / "outcomes.png")
    plot_calibration(by_cell, folder / "calibration.png")
    return by_cell


def add(first: Record, second: Record) -> Record:
    """Return the sum of two records."""
    return {key: (np.array(first[key]) + np.array(second[key])).tolist() for key in first}


def pooled(by_cell: dict[Cell, Record], cells: Iterable[Cell]) -> Record | None:
    """Return the sum of the records of ``cells``, None when the study has none of them."""
    total: Record | None = None
    for cell in cells:
        if cell in by_cell:
            total = add(total, by_cell[cell]) if total else by_cell[cell]
    return total


def percent(outcome: Sequence[int]) -> str:
    """Return 'refused / wrong' in percent of all answers."""
    total = sum(outcome)
    return f"{100 * outcome[1] / total:.2f} / {100 * outcome[2] / total:.3f}"


def tables(by_cell: dict[Cell, Record]) -> str:
    """Return the study's tables as Markdown."""
    return "\n".join((outcome_table(by_cell), further_table(by_cell), calibration_table(by_cell)))


def outcome_table(by_cell: dict[Cell, Record]) -> str:
    """Return the table of Fig. 7: unsuccessful / false positive in percent, the three heads together."""
    lines = [
        "| markers | outliers | published | exact | exact, strict | worst head |",
        "|---|---|---|---|---|---|",
    ]
    for f in range(3, 9):
        for o in range(5):
            heads = [by_cell[c] for c in (Cell(h, f, o, expected=f) for h in range(len(HEADS_MM))) if c in by_cell]
            record = pooled(by_cell, (Cell(h, f, o, expected=f) for h in range(len(HEADS_MM))))
            if record is None:
                continue
            worst = max((one["exact"] for one in heads), key=lambda outcome: (outcome[1], outcome[2]))
            columns = (record["published"], record["exact"], record["strict"], worst)
            lines.append(f"| {f} | {o} | " + " | ".join(percent(column) for column in columns) + " |")
    return "\n".join(["Unsuccessful / false positive, %", "", *lines, ""])


def further_table(by_cell: dict[Cell, Record]) -> str:
    """Return the outcomes beyond the protocol, the three heads together."""
    lines = [
        "| markers | outliers | hidden | expected | true error | published | exact |",
        "|---|---|---|---|---|---|---|",
    ]
    protocol = set(protocol_cells())
    for cell in by_cell:
        if cell in protocol or cell.head != 0:
            continue
        record = pooled(by_cell, (Cell(h, *list(asdict(cell).values())[1:]) for h in range(len(HEADS_MM))))
        if record is not None:
            told = str(cell.expected or "not told")
            lines.append(
                f"| {cell.markers} | {cell.outliers} | {cell.hidden} | {told} | {cell.noise_percent} % "
                f"| {percent(record['published'])} | {percent(record['exact'])} |"
            )
    return "\n".join(["Beyond the protocol: unsuccessful / false positive, %", "", *lines, ""])


def calibration_table(by_cell: dict[Cell, Record]) -> str:
    """Return how often answers of each stated probability are wrong, for each true error."""
    lines = [
        "| true error | stated probability | answers | wrong | wrong as stated |",
        "|---|---|---|---|---|",
    ]
    for noise in (100, 50, 200):
        total = calibration_of(by_cell, noise)
        for low, high, (count, right, stated) in zip(
            PROBABILITY_EDGES, PROBABILITY_EDGES[1:], total, strict=False
        ):
            if count:
                wrong = f"{count - right:.0f} | {count - stated:.2f}"
                lines.append(f"| {noise} % | {low:g} to {high:g} | {count:.0f} | {wrong} |")
    return "\n".join(["Calibration", "", *lines, ""])


def calibration_of(by_cell: dict[Cell, Record], noise_percent: int) -> list[list[float]]:
    """Return the calibration record over the cells of one true error with a right expected number."""
    record = pooled(
        by_cell, (c for c in by_cell if c.noise_percent == noise_percent and c.expected == c.markers - c.hidden)
    )
    return record["calibration"] if record else []
