"""The measured voxels about a place."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.localization.fit.neighbourhood import gather
from ronnaplan.planning.voxels import LEAST_MM3, voxels_near
from tests import cases


def test_voxels_about_a_place_are_those_that_the_compiled_way_gathers() -> None:
    volume = cases.volume()
    for place, reach in (
        (cases.ENTRY_MM, 9.0),
        (np.array([-95.0, 0.0, -20.0]), 20.0),
        (np.array([0.0, 0.0, 900.0]), 5.0),
    ):
        compiled = gather(volume, place, reach, volume.grid.axes)
        offsets, values = voxels_near(volume, place, reach)
        np.testing.assert_array_equal(values, compiled.values_hu)
        np.testing.assert_allclose(offsets, compiled.offsets_mm @ compiled.axes, atol=1e-9)


@pytest.mark.parametrize("spacing_mm", [(0.15, 0.5, 0.5), (0.3, 0.3, 0.3), (0.5, 0.1, 0.1), (0.6, 0.4, 0.4)])
def test_however_fine_the_voxels_a_ball_holds_no_more_than_so_many(
    spacing_mm: tuple[float, float, float],
) -> None:
    reach = 4.0
    k, j, i = np.meshgrid(*(np.arange(2 * int(reach / one) + 4) for one in spacing_mm), indexing="ij")
    volume = CTVolume.from_array(k + 100 * j + 10_000 * i, np.diag([*spacing_mm, 1.0])[[2, 1, 0, 3]])
    middle = volume.grid.positions_mm(np.array([size // 2 for size in k.shape], dtype=float))
    offsets, values = voxels_near(volume, middle, reach)
    index = np.stack([values % 100, values // 100 % 100, values // 10_000], axis=-1)
    np.testing.assert_allclose(offsets, volume.grid.positions_mm(index) - middle, atol=1e-9)
    room = 4 / 3 * np.pi * reach**3
    each = float(np.prod(spacing_mm))
    assert 0.9 * room / max(each, 2 * LEAST_MM3) < len(values) < 1.1 * room / max(each, LEAST_MM3)
    assert np.linalg.norm(offsets, axis=1).max() > 0.9 * reach
