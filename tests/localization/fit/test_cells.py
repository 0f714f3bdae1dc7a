"""Every direction belongs to one cell."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ronnaplan.localization.fit.cells import CELL_COUNT, cell_directions, direction_cells


def test_cells_are_numbered_by_their_own_directions() -> None:
    assert direction_cells(cell_directions()).tolist() == list(range(CELL_COUNT))


@given(arrays(np.float64, (7, 3), elements=st.floats(-1e3, 1e3)))
def test_every_direction_lies_within_its_cell(offsets: np.ndarray) -> None:
    offsets = np.round(offsets, 3) + 5e-4  # never zero
    cells = direction_cells(offsets)
    assert ((cells >= 0) & (cells < CELL_COUNT)).all()
    cosines = np.sum(offsets * cell_directions()[cells], axis=1) / np.linalg.norm(offsets, axis=1)
    assert (cosines > np.cos(np.radians(25))).all()
