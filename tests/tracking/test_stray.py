"""Stray markers of a recording become markers with a mean, a covariance and their flags."""

import numpy as np
import pytest
import scipy.optimize
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.tracking import MarkerFlag, PointReading, Recording, ToolReading, find_markers, stray
from ronnaplan.tracking.stray import GATE_MM, assigned
from ronnaplan.tracking.told import readings_told
from ronnaplan.transforms import rigid
from tests.long import few_or_all

TRUTH = np.array([[-60.0, 20, -1040], [55, 30, -1050], [5, -85, -1060], [-20, 60, -1075], [30, -10, -1095]])
JITTER = 0.1


def recording(seed: int, frames: int = 300, drop: float = 0.05) -> list[PointReading]:
    """Frames of shuffled strays with dropouts, a reflection now and then, and gross outliers."""
    rng = np.random.default_rng(seed)
    readings = []
    for frame in range(frames):
        points = [p + rng.normal(size=3) * JITTER for p in TRUTH if rng.random() > drop]
        if rng.random() < 0.1:
            points.append(np.array([120.0, 40, -900]) + rng.normal(size=3))  # a reflection in one place
        if rng.random() < 0.05:
            points.append(rng.uniform(-200, 200, 3) - (0, 0, 1000))
        readings += [PointReading(frame, points[k]) for k in rng.permutation(len(points))]
    return readings


def nearest(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    result: np.ndarray = np.linalg.norm(found[:, None] - truth[None], axis=-1).min(axis=0)
    return result


@pytest.mark.parametrize("seed", range(5))
def test_shuffled_strays_with_dropouts_and_reflections_become_the_markers(seed: int) -> None:
    found = find_markers(Recording("test", tuple(recording(seed))))
    assert len(found.markers) == len(TRUTH)
    assert nearest(found.points.positions_mm, TRUTH).max() < 5 * JITTER / np.sqrt(250)
    assert any("of 300 frames" in track.reason for track in found.rejected)
    seen = sum(m.readings + m.outliers for m in found.markers) + sum(t.readings for t in found.rejected)
    assert seen == len(recording(seed))  # nothing lost


@few_or_all("cases", 30, 60)
def test_means_scatter_as_the_jitter_part_of_their_covariance_says(cases: int) -> None:
    squared = []
    for seed in range(cases):
        found = find_markers(Recording("test", tuple(recording(seed, frames=150))), sigma_mm=0.0)
        order = [int(np.linalg.norm(found.points.positions_mm - t, axis=1).argmin()) for t in TRUTH]
        error = found.points.positions_mm[order] - TRUTH
        squared.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.points.covariances_mm2[order]), error))
    assert np.mean(squared) == pytest.approx(3.0, rel=0.2)


def test_averaging_does_not_remove_the_trackers_own_error() -> None:
    found = find_markers(Recording("test", tuple(recording(0, frames=300))), sigma_mm=0.2)
    assert np.all(np.linalg.eigvalsh(found.points.covariances_mm2) >= 0.2**2)


def test_outliers_of_a_marker_are_counted_and_do_not_pull_its_mean() -> None:
    rng = np.random.default_rng(1)
    readings = [PointReading(k, TRUTH[0] + rng.normal(size=3) * JITTER + (k % 20 == 3) * 1.5) for k in range(200)]
    marker = find_markers(Recording("test", tuple(readings))).markers[0]
    assert marker.outliers == 10
    assert np.linalg.norm(marker.position_mm - TRUTH[0]) < 0.05


def test_a_marker_that_moves_or_vanishes_is_flagged() -> None:
    rng = np.random.default_rng(2)
    readings = []
    for frame in range(200):
        for k, place in enumerate(TRUTH):
            drift = (k == 1) * frame * np.array([0.01, 0, 0])
            if not (k == 2 and frame > 150):
                readings.append(PointReading(frame, place + drift + rng.normal(size=3) * JITTER))
    flags = [marker.flags for marker in find_markers(Recording("test", tuple(readings))).markers]
    assert flags[1] == (MarkerFlag.MOVED,)
    assert flags[2] == (MarkerFlag.LOST, MarkerFlag.DROPOUTS)
    assert flags[0] == flags[3] == flags[4] == ()


@pytest.mark.parametrize("drift_mm", [0.0, 5.0])
def test_how_far_the_head_moved_while_it_was_recorded_is_told_and_that_no_error_counts_it(drift_mm: float) -> None:
    rng = np.random.default_rng(2)
    drifts = drift_mm * np.array([0.6, 0.7, 1.0, 0.9, 0.8])  # a head that turns
    readings = [
        PointReading(k, place + np.array([drift * k / 99, 0, 0]) + rng.normal(size=3) * JITTER, label)
        for k in range(100)
        for label, place, drift in zip("ABCDE", TRUTH, drifts, strict=True)
    ]
    recorded = Recording("test", tuple(readings))
    found = find_markers(recorded)
    told = [note for note in readings_told(recorded, found) if "the expected error does not count that" in note]
    if not drift_mm:
        assert not told
        assert all(marker.moved_mm == 0 for marker in found.markers)
        return
    for marker, drift in zip(found.markers, drifts, strict=True):  # from the first quarter's mean to the last's
        assert marker.moved_mm == pytest.approx(0.75 * drift, abs=0.1)
    assert len(told) == 1
    assert told[0].startswith("5 of 5 readings moved while they were recorded, the farthest by at least 3.")


@pytest.mark.parametrize(("label", "mm", "left"), [("A", 30.0, 0.6), ("", 3.0, 0.6), ("A", 3.0, 0.85)])
@pytest.mark.parametrize("frames", [20, 60])
def test_a_marker_that_left_for_another_place_is_flagged(label: str, mm: float, left: float, frames: int) -> None:
    """It is given where most readings lie: where it was, as when camera or patient are moved late in a recording."""
    rng = np.random.default_rng(3)
    away = np.array([mm, 0, 0])
    readings = [
        PointReading(k, TRUTH[0] + (k >= left * frames) * away + rng.normal(size=3) * JITTER, label)
        for k in range(frames)
    ]
    (marker,) = find_markers(Recording("test", tuple(readings))).markers
    assert np.linalg.norm(marker.position_mm - TRUTH[0]) < 0.1
    assert marker.flags == (MarkerFlag.MOVED,)
    assert marker.moved_mm == pytest.approx(mm, abs=0.2)
    assert find_markers(Recording("test", tuple(readings[::-1]))).markers[0].flags == marker.flags
    readings[-2:] = [PointReading(frames - 2, TRUTH[0], label), PointReading(frames - 1, TRUTH[0] + away, label)]
    came_back = find_markers(Recording("test", tuple(readings))).markers[0]
    assert came_back.flags == ()


def test_labels_and_stated_errors_of_the_source_are_kept() -> None:
    readings = [PointReading(0, p, label, sigma_mm=0.3) for p, label in zip(TRUTH, "ABCDE", strict=True)]
    found = find_markers(Recording("test", tuple(readings)))
    assert found.points.labels == tuple("ABCDE")
    np.testing.assert_allclose(found.points.covariances_mm2, np.tile(0.09 * np.eye(3), (5, 1, 1)))
    assert found.markers[0].flags == (MarkerFlag.SINGLE_READING,)


def test_readings_that_state_no_error_are_not_as_good_as_those_that_do() -> None:
    readings = [PointReading(k, TRUTH[0], "A", sigma_mm=0.01 if k == 0 else None) for k in range(10)]
    covariance = find_markers(Recording("test", tuple(readings)), sigma_mm=0.2).markers[0].covariance_mm2
    np.testing.assert_allclose(covariance, (0.01**2 + 9 * 0.2**2) / 10 * np.eye(3))


def test_markers_where_another_stands_are_told_to_be_read_twice() -> None:
    unnumbered = Recording("test", tuple(PointReading(0, p + 0.1 * k, "") for k in range(3) for p in TRUTH))
    told = readings_told(unnumbered, find_markers(unnumbered))
    assert any("15 of 15 readings stand within 4 mm of another" in note for note in told)
    numbered = Recording("test", tuple(PointReading(k, p + 0.1 * k, "") for k in range(3) for p in TRUTH))
    assert not readings_told(numbered, find_markers(numbered))


def test_markers_touched_one_after_the_other_are_all_kept_by_their_labels() -> None:
    readings = [PointReading(100 * k, p, label) for k, (p, label) in enumerate(zip(TRUTH, "ABCDE", strict=True))]
    assert find_markers(Recording("test", tuple(readings))).points.labels == tuple("ABCDE")


def test_a_label_given_to_two_places_in_one_frame_is_no_marker() -> None:
    readings = [PointReading(0, TRUTH[0], "A"), PointReading(0, TRUTH[1], "A"), PointReading(0, TRUTH[2], "B")]
    found = find_markers(Recording("test", tuple(readings)))
    assert found.points.labels == ("B",)
    assert "mm apart in one frame" in found.rejected[0].reason


def test_a_label_at_two_places_in_two_frames_has_moved() -> None:
    readings = [PointReading(k, TRUTH[k], "A") for k in range(2)]
    (marker,) = find_markers(Recording("test", tuple(readings))).markers
    assert MarkerFlag.MOVED in marker.flags
    assert np.sqrt(np.trace(marker.covariance_mm2)) > 30


def test_a_label_that_jumps_between_two_places_has_moved() -> None:
    """As of zeros that stand for nothing seen in every other frame: it was given amid them, without a word."""
    readings = [PointReading(k, TRUTH[0] * (k % 2), "A") for k in range(20)]
    (marker,) = find_markers(Recording("test", tuple(readings))).markers
    assert marker.flags == (MarkerFlag.MOVED,)


def test_poses_in_several_coordinates_are_no_markers_of_one() -> None:
    tools = tuple(ToolReading(0, name, np.eye(4)) for name in ("ProbeToTracker", "ImageToProbe"))
    with pytest.raises(FrameMismatchError, match="coordinates of Probe, Tracker"):
        find_markers(Recording("test", (), tools))
    assert len(find_markers(Recording("test", (), tools[:1])).markers) == 1


def test_a_faster_stream_of_tools_does_not_make_markers_rare() -> None:
    tools = tuple(ToolReading(k, "probe", np.eye(4)) for k in range(1000))
    assert len(find_markers(Recording("test", tuple(recording(0, frames=100)), tools)).markers) == len(TRUTH)


def test_tool_poses_alone_give_their_origins() -> None:
    pose = np.eye(4)
    pose[:3, 3] = TRUTH[0]
    found = find_markers(
        Recording("test", tools=(ToolReading(0, "A", pose), ToolReading(1, "A", None, status="missing")))
    )
    np.testing.assert_array_equal(found.points.positions_mm, TRUTH[:1])


def test_a_recording_without_a_usable_reading_says_why() -> None:
    bad = PointReading(0, np.full(3, np.nan), status="missing")
    with pytest.raises(InputError, match="1 missing"):
        find_markers(Recording("test", (bad,)))
    with pytest.raises(InputError, match="empty"):
        find_markers(Recording("test"))


@pytest.mark.parametrize("sigma", [-1.0, float("nan"), 1e300])
def test_an_impossible_tracker_error_is_refused(sigma: float) -> None:
    with pytest.raises(InputError, match="tracker error"):
        find_markers(Recording("test", tuple(recording(0, frames=3))), sigma_mm=sigma)


@pytest.mark.parametrize("sigma", [-0.5, float("nan"), float("inf")])
def test_a_good_reading_states_no_impossible_error(sigma: float) -> None:
    """Below zero it counted as its square, and what is not finite spread into the mean's covariance."""
    with pytest.raises(InputError, match="a reading's error is"):
        PointReading(0, TRUTH[0], "A", sigma_mm=sigma)
    assert not PointReading(0, TRUTH[0], "A", sigma_mm=sigma, status="sigma is wrong").usable


@pytest.mark.parametrize("position", [np.ones((1, 3)), np.ones(2), 5.0])
def test_a_reading_has_three_coordinates(position: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"expected \(3,\)"):
        PointReading(0, position, "A")


class Counted(str):
    """A label that counts how often it is compared."""

    compared = 0
    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        Counted.compared += 1
        return str.__eq__(self, other)

    __hash__ = str.__hash__


def test_labels_are_compared_as_often_as_there_are_readings() -> None:
    count = 900
    readings = [PointReading(0, np.array([50.0 * k, 0, 0]), Counted(f"M{k}")) for k in range(count)]
    Counted.compared = 0
    assert len(find_markers(Recording("test", tuple(readings))).markers) == count
    assert Counted.compared < 10 * count


def test_readings_too_many_to_be_followed_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    many = [PointReading(frame, np.array([50.0 * k, 0, 0])) for frame in (0, 1) for k in range(201)]
    with pytest.raises(InputError, match="frame 0 holds 201 stray readings"):
        find_markers(Recording("test", tuple(many)))
    monkeypatch.setattr(stray, "MOST_TRACKS", 100)
    jumping = [PointReading(frame, np.array([50.0 * frame, 0, 0])) for frame in range(101)]
    with pytest.raises(InputError, match="more than 100 places"):
        find_markers(Recording("test", tuple(jumping)))


@pytest.mark.parametrize("seed", range(3))
def test_readings_go_to_tracks_at_the_least_total_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    last = rng.uniform(0, 12, (30, 3))
    current = last[rng.permutation(30)[:25]] + rng.normal(0, 1.0, (25, 3))
    current[0] = last[0]
    distance = cdist(current, last)
    cost = np.where(distance > GATE_MM, 1e6, distance)
    whole = {
        (int(i), int(j)) for i, j in zip(*linear_sum_assignment(cost), strict=True) if distance[i, j] <= GATE_MM
    }
    assert set(assigned(current, last, GATE_MM).items()) == whole


def test_strays_that_lie_apart_are_followed_without_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = []
    searched = scipy.optimize.linear_sum_assignment

    def counted(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sizes.append(cost.size)
        return searched(cost)

    monkeypatch.setattr(scipy.optimize, "linear_sum_assignment", counted)
    assert len(find_markers(Recording("test", tuple(recording(0, frames=20)))).markers) == len(TRUTH)
    assert max(sizes) == 0


def test_a_label_read_in_places_that_do_not_agree_is_no_marker() -> None:
    places = 100 * np.eye(3)
    readings = [PointReading(k, place, "A") for k, place in enumerate(places)]
    readings += [PointReading(k, np.array([0.0, 0, 50]), "B") for k in range(3)]
    found = find_markers(Recording("test", tuple(readings)))
    assert [marker.label for marker in found.markers] == ["B"]
    assert found.rejected[0].reason == "no two of its coordinates agree"


def test_of_many_reasons_why_nothing_is_usable_some_are_told() -> None:
    points = [PointReading(0, np.zeros(3), status=f"fault {number}") for number in range(9)]
    with pytest.raises(InputError, match=r"\(1 fault 0, .*, 1 fault 4, and 4 more reasons\)"):
        find_markers(Recording("r", tuple(points)))


def test_one_marker_is_counted_as_one() -> None:
    one = PointReading(0, np.array([1.0, 2.0, 3.0]), "F1")
    found = find_markers(Recording("x", (one,)))
    assert repr(found).startswith("MarkerReadings(1 marker in 1 frame of ")


@pytest.mark.parametrize("places", [100 * np.eye(3), np.array([[1.0, 2, 3], [90, 20, 30], [9, 80, 70]])])
def test_of_a_pointer_that_touched_the_markers_it_is_told_how_to_write_its_touches(places: FloatArray) -> None:
    """Its poses are one marker that moved, which could not be told to rest."""
    poses = np.repeat(places, 8, axis=0)
    tools = tuple(ToolReading(k, "probe", rigid(np.eye(3), place)) for k, place in enumerate(poses))
    recording = Recording("r", tools=tools)
    told = readings_told(recording, find_markers(recording))
    assert any("write each touch in a row of its own" in one for one in told)
    assert not any("have them rest" in one for one in told)
