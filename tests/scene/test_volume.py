"""A whole scan for a graphics card: values where they are, blocks that hide nothing, tables."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.scene.field import Field
from ronnaplan.scene.volume import BLOCK, HIGH_HU, LOW_HU, MOST_CELLS, PRESETS, Volume, table


@pytest.fixture
def field() -> Field:
    """A ball of bone in skin."""
    z, y, x = np.meshgrid(*(np.arange(60.0),) * 3, indexing="ij")
    away = np.hypot(np.hypot(z - 30, y - 26), x - 30)
    values = np.where(away < 20, 40.0, -1000.0) + np.where(away < 14, 900.0, 0.0)
    return Field(values.astype(np.float32), np.array([-10.0, 5.0, 100.0]), 1.5)


def test_a_scan_is_where_it_is_in_steps_of_a_few_hu(field: Field) -> None:
    found = Volume.of(field)
    assert found.low_mm.tolist() == [-10.75, 4.25, 99.25]
    assert found.shape["size"] == [90.0, 90.0, 90.0]
    hu = LOW_HU + found.values / 255.0 * (HIGH_HU - LOW_HU)
    assert hu[30, 26, 30] == pytest.approx(940.0, abs=12.0)
    assert hu[30, 26, 48] == pytest.approx(40.0, abs=12.0)
    assert len(found.packed) == 60**3 + 8**3


def test_a_block_tells_the_greatest_value_that_a_ray_may_meet_in_it() -> None:
    values = np.zeros((17, 16, 16), dtype=np.uint8)
    values[8, 3, 3] = 200  # seen from the block before it, too: values between cells are interpolated
    greatest = Volume(values, np.zeros(3), 1.0).greatest
    assert greatest.shape == (3, 2, 2)
    assert greatest[0, 0, 0] == greatest[1, 0, 0] == 200
    assert greatest[2].max() == greatest[:, 1].max() == 0


def test_no_more_cells_than_every_browser_takes() -> None:
    long = Field(np.full((600, 4, 4), -1000.0, dtype=np.float32), np.zeros(3), 1.0)
    found = Volume.of(long)
    assert max(found.values.shape) <= MOST_CELLS
    assert found.cell_mm * found.values.shape[0] == pytest.approx(600.0, abs=found.cell_mm)


@pytest.mark.parametrize("name", PRESETS)
def test_air_is_never_seen_and_all_is_denser_where_it_is_asked_for(name: str) -> None:
    usual, dense = table(PRESETS[name], 1.0), table(PRESETS[name], 4.0)
    assert usual[: round(255 * (-800 - LOW_HU) / (HIGH_HU - LOW_HU)), 3].max() == 0
    assert usual[-1, 3] > 200 or name == "vessels and metal"
    assert (dense[:, 3].astype(int) >= usual[:, 3]).all()
    assert dense[:, 3].astype(int).sum() > usual[:, 3].astype(int).sum()
    assert BLOCK == 8  # page/volume.js counts on it
