"""Markers are followed by label through a recording, however the tracker lists them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame, Points
from ronnaplan.tracking import PointReading, Recording
from ronnaplan.tracking.frames import labelled_frames

PLACES = np.array([[-60.0, 20, -1040], [55, 30, -1050], [5, -85, -1060]])
REFERENCE = Points(PLACES, np.tile(0.03 * np.eye(3), (3, 1, 1)), ("F1", "F2", "F3"), Frame("OTS"))


def test_a_slowly_moving_head_keeps_its_labels_in_any_order_and_with_dropouts() -> None:
    rng = np.random.default_rng(0)
    readings = []
    for k in range(100):
        seen = PLACES + np.array([0.5 * k, 0, 0])
        readings += [PointReading(k, seen[i]) for i in rng.permutation(3) if not (k == 50 and i == 1)]
        readings.append(PointReading(k, np.array([300.0, 300, -900])))
    frames = labelled_frames(Recording("test", tuple(readings)), REFERENCE)
    assert [number for number, _ in frames] == list(range(100))
    for k, points in frames:
        expected = {
            label: place + np.array([0.5 * k, 0, 0]) for label, place in zip(REFERENCE.labels, PLACES, strict=True)
        }
        assert len(points) == (2 if k == 50 else 3)
        for label, place in zip(points.labels, points.positions_mm, strict=True):
            np.testing.assert_allclose(place, expected[label])


def test_a_marker_that_is_read_at_two_places_of_one_frame_is_not_seen_there() -> None:
    moved = PLACES[:2] + np.array([1.2, 0, 0])
    twice = [PointReading(0, place) for place in (*PLACES, *moved)]
    again = [PointReading(1, place) for place in (*PLACES, *PLACES)]
    (_, first), (_, second) = labelled_frames(Recording("test", (*twice, *again)), REFERENCE)
    assert first.labels == ("F3",)
    assert sorted(second.labels) == ["F1", "F2", "F3"]


@pytest.mark.parametrize("away_mm", [3.0, 7.0, 40.0])
def test_markers_that_are_read_once_more_elsewhere_are_not_seen(away_mm: float) -> None:
    """Of two heads in one frame one is of before a movement; beyond 5 mm the former was taken for a head at rest."""
    moved = (PLACES - PLACES[0]) @ Rotation.from_euler("z", 2.0, degrees=True).as_matrix() + PLACES[0]
    moved += np.array([0.0, away_mm, 0.0])
    strays = PLACES + np.array([[30.0, 0, 0], [0, 45.0, 0], [-15.0, 0, 60.0]])
    both, beside = ([PointReading(k, one) for one in (*PLACES, *more)] for k, more in enumerate((moved, strays)))
    (_, first), (_, second) = labelled_frames(Recording("test", (*both, *beside)), REFERENCE)
    assert first.labels == ()
    assert sorted(second.labels) == ["F1", "F2", "F3"]


@pytest.mark.parametrize(("count", "seen"), [(300, 3), (400, 0)])
def test_among_more_reflections_than_can_be_compared_no_marker_is_seen(count: int, seen: int) -> None:
    """These lie in a row, and are no markers once more."""
    row = PLACES.mean(axis=0) + np.linspace(0.0, 30.0, count)[:, np.newaxis] * np.eye(3)[0]
    crowd = [PointReading(0, one) for one in (*PLACES, *row)]
    ((_, points),) = labelled_frames(Recording("test", tuple(crowd)), REFERENCE)
    assert len(points) == seen


def test_a_frame_without_usable_readings_is_kept_empty() -> None:
    recording = Recording("test", (PointReading(4, np.full(3, np.nan), status="missing"),))
    ((number, points),) = labelled_frames(recording, REFERENCE)
    assert number == 4
    assert len(points) == 0


def test_more_readings_in_a_frame_than_a_tracker_sees_are_refused() -> None:
    for count in (1200, 1201):
        recording = Recording("test", tuple(PointReading(8, np.full(3, 9.0 * k)) for k in range(count)))
        if count == 1200:
            assert len(labelled_frames(recording, REFERENCE)) == 1
        else:
            with pytest.raises(InputError, match="frame 8 holds 1201 readings; expected 1200 at most"):
                labelled_frames(recording, REFERENCE)


def test_another_frame_or_no_reference_is_refused() -> None:
    with pytest.raises(FrameMismatchError):
        labelled_frames(Recording("test", frame=Frame("R")), REFERENCE)
    with pytest.raises(InputError, match="0 reference markers"):
        labelled_frames(Recording("test"), Points(np.zeros((0, 3)), np.zeros((0, 3, 3)), (), Frame("OTS")))
