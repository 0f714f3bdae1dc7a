"""Wrong distances of one side are told from noise, and from a marker that is bad by itself."""

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.registration import RegistrationFlag, doubted_marker, register_points
from tests.correspondence.scenes import HEAD
from tests.long import few_or_all
from tests.registration.scene import SHIFT, TURN

SDS = (0.1, 0.17)
ERRORS = (SDS[0] ** 2 * np.eye(3), SDS[1] ** 2 * np.eye(3))


def readings(
    rng: np.random.Generator, longer: float | tuple[float, float, float] = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Markers in a scan, and as read where they lie apart by so much more than in the scan, along its axes."""
    true: FloatArray = HEAD * (1 + np.array(longer))
    seen = true @ TURN.T + SHIFT + SDS[1] * rng.normal(size=HEAD.shape)
    return HEAD + SDS[0] * rng.normal(size=HEAD.shape), seen


def test_wrong_distances_of_one_side_are_told_with_their_axis() -> None:
    """Of slices farther apart than stated, and of a tracker's scale, neither of which the misfit alone tells."""
    rng = np.random.default_rng(5)
    for longer in ((0.0, 0.0, 0.022), (-0.006, -0.006, -0.006)):
        found = [register_points(*readings(rng, longer), ERRORS) for _ in range(60)]
        told = [one.stretch for one in found if one.stretch is not None]
        assert len(told) > 45
        assert len(told) > sum(RegistrationFlag.MISFIT in one.flags for one in found)
        np.testing.assert_allclose(np.mean(told, axis=0), longer, atol=0.0015)
        assert all((RegistrationFlag.STRETCHED in one.flags) == (one.stretch is not None) for one in found)


@few_or_all("cases", 150, 300)
def test_right_distances_are_not_called_wrong(cases: int) -> None:
    rng = np.random.default_rng(6)
    sound = [register_points(*readings(rng), ERRORS).stretch for _ in range(cases)]
    assert sum(one is not None for one in sound) <= cases // 150


def test_a_bad_marker_is_no_stretch() -> None:
    rng = np.random.default_rng(7)
    stretched = 0
    for _ in range(60):
        scan, seen = readings(rng)
        seen[2] += (1.5, -1.5, 1.5)
        stretched += register_points(scan, seen, ERRORS).stretch is not None
    assert stretched <= 6


def test_flat_markers_tell_no_stretch_across_themselves() -> None:
    rng = np.random.default_rng(8)
    plate = HEAD * (1, 1, 0.01)
    errors = SDS[1] ** 2 * np.eye(3)
    for _ in range(60):
        stretch = register_points(plate, plate + SDS[1] * rng.normal(size=plate.shape), errors).stretch
        assert stretch is None


def test_no_marker_is_certain_to_be_bad_where_a_stretch_explains_it_too() -> None:
    rng = np.random.default_rng(9)
    doubts = []
    for _ in range(60):
        registration = register_points(*readings(rng, (0.0, 0.0, 0.025)), ERRORS)
        doubt = doubted_marker(registration)
        if doubt is not None and registration.stretch is not None:
            doubts.append(doubt)
    assert len(doubts) > 5
    assert not any(doubt.certain for doubt in doubts)
    assert all("a stretch of one side" in str(doubt) for doubt in doubts)
