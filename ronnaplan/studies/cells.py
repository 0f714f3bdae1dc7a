"""The conditions of the simulation study, and the records of several of them together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ronnaplan.correspondence.told import Told
from ronnaplan.studies.blocks import Record
from ronnaplan.studies.heads import HEADS_MM

DRAWN = 0
"""In place of a percentage: each test draws its true errors, from half to four times the stated ones."""

HEADS = range(len(HEADS_MM))


@dataclass(frozen=True, order=True)
class Cell:
    """One condition: ``markers`` on head ``head`` and ``outliers`` in both sets.

    ``hidden`` markers are missing from the tracker's set; ``expected`` and ``at_least`` are what the matcher is told
    (0: nothing); the true errors are ``noise_percent`` of the stated ones (or `DRAWN`).
    """

    head: int
    markers: int
    outliers: int
    hidden: int = 0
    expected: int = 0
    at_least: int = 0
    noise_percent: int = 100

    @property
    def told(self) -> Told:
        """What the matcher is told."""
        return Told(self.expected or None, self.at_least or None)


def protocol_cells() -> list[Cell]:
    """Return the paper's 90 cells: 3 heads, 3 to 8 markers, 0 to 4 outliers."""
    return [Cell(h, f, o, expected=f) for f in range(3, 9) for o in range(5) for h in HEADS]


def further_cells() -> list[Cell]:
    """Return the cells beyond the protocol: other errors, unknown numbers, hidden markers, wrong numbers."""
    markers = [(3, 0), (3, 2), (3, 4), (4, 2), (5, 2), (8, 2)]
    errors = [
        Cell(h, f, o, expected=f, noise_percent=n)
        for n in (50, 200, 400, DRAWN)
        for f, o in markers
        for h in HEADS
    ]
    unknown = [Cell(h, f, o) for f in range(3, 9) for o in range(5) for h in HEADS]
    at_least = [Cell(h, f, o, at_least=3) for f, o in (*markers, (8, 4)) for h in HEADS]
    hidden = [
        Cell(h, 8, o, hidden=k, expected=e)
        for k in (1, 2)
        for o in (0, 2, 4)
        for e in (0, 8, 8 - k)
        if e <= 8 - k + o  # the sets can hold them
        for h in HEADS
    ]
    wrong_number = [Cell(h, 6, 2, expected=e) for e in (5, 7) for h in HEADS]
    return errors + unknown + at_least + hidden + wrong_number


def add(first: Record, second: Record) -> Record:
    """Return the sum of two records."""
    return {key: (np.array(first[key]) + np.array(second[key])).tolist() for key in first}


def all_heads(by_cell: dict[Cell, Record], cell: Cell) -> Record | None:
    """Return the sum of the records of one condition on every head, None when the study has none of them."""
    return pooled(by_cell, (replace(cell, head=head) for head in HEADS))


def pooled(by_cell: dict[Cell, Record], cells: Iterable[Cell]) -> Record | None:
    """Return the sum of the records of ``cells``, None when the study has none of them."""
    total: Record | None = None
    for cell in cells:
        if cell in by_cell:
            total = add(total, by_cell[cell]) if total else by_cell[cell]
    return total


def calibration_of(by_cell: dict[Cell, Record], noise_percent: int) -> list[list[float]]:
    """Return the calibration record over the cells of one true error that were told the right number."""
    told = (c for c in by_cell if c.noise_percent == noise_percent and c.expected == c.markers - c.hidden)
    record = pooled(by_cell, told)
    return record["calibration"] if record else []
