"""Volumes and maps show themselves in a line and in pictures."""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256
from typing import Any

import numpy as np
import pytest

from ronnaplan.ct import CTVolume, ScalarMap, VolumeFlag
from ronnaplan.errors import InputError
from ronnaplan.figures import ThreeViews
from ronnaplan.geometry import FloatArray

SLOPE = np.array([0.1, -0.2, 0.3])


def a_map() -> ScalarMap:
    """A map on slices that lie on their side, whose value at each place is the place times `SLOPE`."""
    affine = np.array([[2.0, 0, 0, -10], [0, 0, -3.0, 50], [0, 4.0, 0, 7], [0, 0, 0, 1]])
    turned = CTVolume.from_array(np.zeros((6, 7, 8), np.int16), affine)
    places = turned.grid.positions_mm(np.moveaxis(np.indices(turned.voxels_hu.shape), 0, -1).astype(float))
    return ScalarMap((places @ SLOPE).astype(np.float32), turned.grid, "slope", "mm", turned.frame)


def test_a_map_is_drawn_in_three_planes_where_its_values_are(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: dict[str, Any] = {}

    def fields(
        self: ThreeViews, values: Any, middle: FloatArray, low: FloatArray, high: FloatArray, label: str
    ) -> None:
        drawn.update(values=values, middle=middle, low=low, high=high, label=label)

    with monkeypatch.context() as patched:
        patched.setattr(ThreeViews, "fields", fields)
        a_map().plot([-5.0, 40.0, 20.0])
    np.testing.assert_allclose([drawn["low"], drawn["high"]], [[-10, 29, 7], [0, 50, 31]])
    places = np.array([[-10.0, 29, 7], [-3.3, 41.7, 12.1], [0, 50, 31], [0.1, 40, 20], [-5, 28, 20]])
    np.testing.assert_allclose(drawn["values"](places[:3]), places[:3] @ SLOPE, atol=1e-5)
    assert np.isnan(drawn["values"](places[3:])).all()
    assert drawn["label"] == "slope, mm"


def test_a_maps_picture_has_the_place_the_points_and_round_figures() -> None:
    picture = a_map().plot([-5.0, 40.0, 20.0], [[-2.0, 45.0, 9.0]])
    assert picture.png().startswith(b"\x89PNG")
    axial, coronal, sagittal, bar = picture.axes
    assert [axes.get_title() for axes in (axial, coronal, sagittal)] == ["axial", "coronal", "sagittal"]
    assert axial.yaxis_inverted()
    np.testing.assert_array_equal(axial.collections[-1].get_offsets(), [[-2.0, 45.0]])
    assert "(-5.0, 40.0, 20.0) mm" in picture.get_suptitle()
    assert all(len(tick.get_text()) <= 5 for tick in bar.get_yticklabels())
    np.testing.assert_allclose(a_map().plot().axes[0].get_xlim(), (-10, 0))
    with pytest.raises(InputError, match=r"\(90\.0, 0\.0, 0\.0\) mm is outside of the map"):
        a_map().plot([90, 0, 0])
    with pytest.raises(InputError, match=r"^through_mm has shape \(2,\)"):
        a_map().plot([-5.0, 40.0])


def test_a_scan_names_its_flags_in_its_line() -> None:
    scan = CTVolume.from_array(np.zeros((6, 7, 8), np.int16), np.eye(4))
    assert repr(replace(scan, flags=(VolumeFlag.DERIVED,))).endswith(" mm, derived)")


@pytest.mark.parametrize("kind", ["<i2", ">i2", "i4", "f4", ">f4", "f8", "F"])
def test_the_same_values_are_the_same_scan_in_any_array(kind: str) -> None:
    values = np.random.default_rng(3).integers(-1024, 3072, (4, 5, 6)).astype(np.int16)
    scan = CTVolume.from_array(values, np.eye(4)[[2, 1, 0, 3]])
    assert scan.voxel_sha256 == sha256(values.astype("<i2").tobytes()).hexdigest()
    held = np.asfortranarray(values) if kind == "F" else values.astype(kind)
    assert replace(scan, voxels_hu=held).voxel_sha256 == scan.voxel_sha256
    parts = values.astype("f4")
    parts[3, 4, 5] += 0.25
    assert replace(scan, voxels_hu=parts).voxel_sha256 == sha256(parts.astype("<f4").tobytes()).hexdigest()


def test_voxels_that_are_cubes_are_told() -> None:
    def in_cubes(pixel_mm: float, gap_mm: float) -> bool:
        voxels_hu = np.zeros((4, 5, 6), np.int16)
        return CTVolume.from_array(voxels_hu, np.diag([pixel_mm, pixel_mm, gap_mm, 1.0])).grid.is_in_cubes

    assert [in_cubes(0.4, 0.4), in_cubes(0.4, 0.403), in_cubes(0.4, 0.5)] == [True, True, False]
