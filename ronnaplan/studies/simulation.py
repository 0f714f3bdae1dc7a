"""The simulation study: the paper's 900,000 tests (section 4.2, Fig. 7), and tests beyond its protocol."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ronnaplan.studies.blocks import Record, run_blocks, write_whole
from ronnaplan.studies.cells import DRAWN, Cell, add, further_cells, protocol_cells
from ronnaplan.studies.heads import HEADS_MM
from ronnaplan.studies.judging import judge_exact, judge_published
from ronnaplan.studies.scenes import simulate_scenes

BLOCK_TESTS = 1000
DRAWN_SCALES = (0.5, 4.0)
"""Between these the errors of a test are drawn, their logarithms uniform, where a cell says so."""


def run_block(*block: int) -> Record:
    """Run a block of tests of one cell and count the outcomes of both algorithms.

    ``block``: the values of a `Cell`, the block's index in the cell, the number of tests, and the seed.
    """
    cell, (index, tests, seed) = Cell(*block[:-3]), block[-3:]
    where = (cell.head, cell.markers, cell.outliers, cell.hidden, cell.noise_percent, index)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=where))
    noise = np.full(tests, cell.noise_percent / 100.0)
    if cell.noise_percent == DRAWN:
        noise = np.exp(rng.uniform(np.log(DRAWN_SCALES[0]), np.log(DRAWN_SCALES[1]), tests))
    scenes = simulate_scenes(
        rng, HEADS_MM[cell.head], tests, cell.markers, cell.outliers, hidden=cell.hidden, noise=noise
    )
    record = judge_exact(scenes, cell.told)
    expected = cell.expected or cell.markers - cell.hidden
    record["published"] = judge_published(scenes, expected, one_to_one=True)
    record["published, any partner"] = judge_published(scenes, expected, one_to_one=False)
    return record


def run_simulation(
    folder: Path,
    tests: int,
    seed: int,
    *,
    further: bool,
    workers: int | None = None,
    scheduler: str | None = None,
) -> dict[Cell, Record]:
    """Run the study of ``tests`` tests a cell, resumably, into ``folder``: journal, results.json, table.md, plots.

    ``further``: also the cells beyond the paper's protocol.  Returns the record of each cell.
    """
    from ronnaplan.studies.plots import plot_calibration, plot_outcomes
    from ronnaplan.studies.tables import tables

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
        cell = Cell(*block[:-3])
        by_cell[cell] = add(by_cell[cell], record) if cell in by_cell else record
    results = [{**asdict(cell), **record} for cell, record in by_cell.items()]
    write_whole(folder / "results.json", json.dumps({**settings, "cells": results}, indent=1) + "\n")
    write_whole(folder / "table.md", tables(by_cell))
    plot_outcomes(by_cell, folder / "outcomes.png")
    plot_calibration(by_cell, folder / "calibration.png")
    return by_cell
