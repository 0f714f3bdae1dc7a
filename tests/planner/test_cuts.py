"""A cut shows what lies where it says, on tilted stacks too."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest

from ronnaplan.planner.cuts import STANDARD, jpeg, path_axes, picture, png, sampled
from ronnaplan.planning import Trajectory
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.scene.cut import Cut
from tests.scans import balls, scan, small_stack

CENTER = np.array([3.0, -4.0, 2.0])
PIXELS = 400
WINDOW = (-1000.0, 200.0)


@cache
def scanned(tilt_deg: float = 0.0) -> SliceSampler:
    return SliceSampler.of(scan(balls([tuple(CENTER)]), small_stack(tilt_deg=tilt_deg)))


def drawn(cut: Cut, shape: tuple[int, int], tilt_deg: float = 0.0) -> np.ndarray:
    return picture(scanned(tilt_deg), cut, WINDOW, shape)


def decoded(data: bytes) -> np.ndarray:
    return np.asarray(cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE))


@pytest.mark.parametrize("view", STANDARD)
@pytest.mark.parametrize(("tilt_deg", "beyond"), [(0.0, (0, 0)), (12.0, (0, 150)), (0.0, (90, 0))])
def test_a_marker_is_a_disc_of_its_size_where_the_screen_coordinates_say(
    view: str, tilt_deg: float, beyond: tuple[int, int]
) -> None:
    right, down = STANDARD[view]
    cut = Cut(right, down, CENTER - 5.0 * right + 3.0 * down, 40.0)
    shape = (PIXELS + beyond[0], PIXELS + beyond[1])
    bright = np.argwhere(drawn(cut, shape, tilt_deg) > 110)
    place_mm = (bright.mean(axis=0) + 0.5 - np.array(shape) / 2) * 40.0 / PIXELS
    assert place_mm[::-1] == pytest.approx(cut.on_screen_mm(CENTER)[:2], abs=0.1)
    assert len(bright) * (40.0 / PIXELS) ** 2 == pytest.approx(np.pi * 5.75**2, rel=0.04)


@pytest.mark.parametrize("view", STANDARD)
def test_a_cut_along_the_voxels_holds_what_it_does_by_the_way_for_oblique_ones(
    view: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    right, down = STANDARD[view]
    for cut in (Cut(right, down, CENTER + 0.37, 40.0), Cut(right, down, CENTER + 25.0, 60.0)):
        quick = sampled(scanned(), cut, (150, 190))
        with monkeypatch.context() as patched:
            patched.setattr("ronnaplan.scene.sampled._level_axis", lambda *_: None)
            np.testing.assert_allclose(quick, sampled(scanned(), cut, (150, 190)), rtol=0, atol=0.1)


def test_the_patients_left_is_on_the_right_and_the_head_is_up() -> None:
    left, up, front = np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0, -1.0, 0])
    for view in ("axial", "coronal"):
        assert Cut(*STANDARD[view], np.zeros(3), 1.0).on_screen_mm(left)[0] == 1.0
    assert Cut(*STANDARD["axial"], np.zeros(3), 1.0).on_screen_mm(front)[1] == -1.0
    for view in ("coronal", "sagittal"):
        assert Cut(*STANDARD[view], np.zeros(3), 1.0).on_screen_mm(up)[1] == -1.0


def test_screen_and_scan_coordinates_are_inverse_to_each_other() -> None:
    cut = Cut(*STANDARD["sagittal"], np.array([1.0, 2.0, 3.0]), 80.0)
    assert cut.on_screen_mm(cut.place_mm(4.0, -5.0)) == pytest.approx([4.0, -5.0, 0.0])


def test_the_path_views_hold_and_cross_the_path() -> None:
    path = Trajectory("A", np.array([1.0, 2.0, 80.0]), np.array([10.0, -5.0, 20.0]))
    right, down = path_axes("inline", path)
    assert down == pytest.approx(path.inward)
    assert right @ path.inward == pytest.approx(0.0, abs=1e-12)
    probe = Cut(*path_axes("probe", path), path.target_mm, 60.0)
    assert probe.away == pytest.approx(path.inward)


def test_a_picture_at_rest_is_without_loss_and_one_that_moves_is_small() -> None:
    shades = drawn(Cut(*STANDARD["axial"], CENTER, 40.0), (300, 500))
    assert (decoded(png(shades)) == shades).all()
    assert len(jpeg(shades)) < len(png(shades)) / 2
    assert np.abs(decoded(jpeg(shades)).astype(int) - shades).mean() < 3
