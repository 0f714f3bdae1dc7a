"""Each measure of a trajectory equals its closed form on a head of ellipsoids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from phantoms.materials import material
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import FloatArray, Frame
from ronnaplan.planning import Instrument, Landmarks, Trajectory, measure
from ronnaplan.planning.apart import spacings
from ronnaplan.planning.measures import DEEPEST_ENTRY_MM
from ronnaplan.planning.obstacles import POST_RADIUS_MM, Kind, PostedMarker, Voxels, markers_on, metal
from tests.long import few_and_others
from tests.planning.heads import BRAIN, FOOT, SCALP, SKULL, normal, paths, reach, scanned

CT = Frame("CT", "1.2.3")
ELECTRODE = Instrument("electrode", 0.8, 150.0)


def path(target: FloatArray, outward: FloatArray, name: str = "A") -> Trajectory:
    return Trajectory(name, target + reach(target, outward, SCALP) * outward, target, CT, ELECTRODE)


@few_and_others("stack", ["tilted", "uneven"], ["plain", "oblique"])
def test_depths_thickness_and_angle(stack: str) -> None:
    for target, outward in paths(4, seed=9):
        measured = measure(path(target, outward), scanned(stack))
        to_scalp, to_skull, to_brain = (reach(target, outward, axes) for axes in (SCALP, SKULL, BRAIN))
        cosine = outward @ normal(target + to_skull * outward, SKULL)
        assert measured.length_mm == pytest.approx(to_scalp, abs=1e-9)
        assert measured.depth_below_scalp_mm == pytest.approx(to_scalp, abs=0.05)
        assert measured.depth_below_skull_mm == pytest.approx(to_skull, abs=0.05)
        assert measured.skull_thickness_mm == pytest.approx(to_skull - to_brain, abs=0.05)
        assert measured.entry_below_scalp_mm == pytest.approx(0.0, abs=0.05)
        assert measured.skull_angle_deg == pytest.approx(np.degrees(np.arccos(cosine)), abs=0.1)
        assert measured.clearances == ()
        assert measured.error is None


def test_a_surface_that_is_not_clear_gives_no_angle_and_says_so() -> None:
    target, outward = np.array([5.0, 3.0, 10.0]), np.array([0.0, 0.6, 0.8])
    measured = measure(path(target, outward), scanned("plain"))
    assert measured.doubts == ()
    assert measured.crossings.outer is not None
    unclear = replace(measured.crossings, outer=replace(measured.crossings.outer, clear=False))
    doubted = replace(measured, crossings=unclear)
    assert doubted.skull_angle_deg is None
    assert "outer table is not clear" in doubted.doubts[0]


@pytest.mark.parametrize("below_mm", [0.0, DEEPEST_ENTRY_MM - 1.0, DEEPEST_ENTRY_MM + 1.0, 37.0])
def test_an_entry_deeper_than_the_skull_is_doubted(below_mm: float) -> None:
    target, outward = np.array([5.0, 3.0, 10.0]), np.array([0.0, 0.6, 0.8])
    whole = path(target, outward)
    told = measure(replace(whole, entry_mm=whole.entry_mm - below_mm * outward), scanned("plain")).doubts
    said = f"the entry lies {below_mm:.0f} mm beneath the scalp"
    assert [one.startswith(said) for one in told] == ([True] if below_mm > DEEPEST_ENTRY_MM else [])


def test_the_profile_shows_each_tissue_at_its_depth() -> None:
    target, outward = np.array([5.0, 3.0, 10.0]), np.array([0.0, 0.6, 0.8])
    measured = measure(path(target, outward), scanned("plain"))
    to_scalp, to_skull, to_brain = (reach(target, outward, axes) for axes in (SCALP, SKULL, BRAIN))
    depths = to_scalp - measured.profile_mm  # from the target outwards
    spans = {"brain": (0, to_brain), "skull": (to_brain, to_skull), "skin": (to_skull, to_scalp)}
    for tissue, (low, high) in spans.items():
        middle = (measured.profile_mm < to_scalp - low - 1.5) & (measured.profile_mm > to_scalp - high + 1.5)
        assert middle.any()
        assert measured.profile_hu[middle].mean() == pytest.approx(material(tissue).nominal_hu, abs=8)
    assert depths[0] == pytest.approx(to_scalp)
    assert measured.profile_mm[-1] == pytest.approx(measured.length_mm)


@few_and_others("stack", ["tilted", "uneven"], ["plain", "oblique"])
def test_distance_to_a_no_go_box_of_voxels_on_any_stack(stack: str) -> None:
    """A block of voxels is a box along the slice axes: a path beside its face keeps a distance known exactly."""
    head = scanned(stack)
    grid = head.volume.grid
    mask = np.zeros(head.volume.voxels_hu.shape, dtype=np.bool_)
    k, j, i = (int(value) for value in np.rint(grid.indices(np.array([20.0, 5.0, 15.0]))))
    # One slice only: a tilted stack shifts its slices, so that a block of several is no box.
    mask[k, j - 3 : j + 4, i - 4 : i + 5] = True
    vessel = Voxels.of(Kind.NO_GO, "vessel", mask, head)
    u, v = (step / np.linalg.norm(step) for step in (grid.column_step_mm, grid.row_step_mm))
    face = grid.positions_mm(np.array([k, j, i + 4.0])) + 0.5 * grid.column_step_mm
    beside = face + 6.25 * u
    trajectory = Trajectory("A", beside - 30 * v, beside + 20 * v, CT, ELECTRODE)
    clearance = vessel.clearance(trajectory)
    assert clearance is not None
    assert clearance.distance_mm == pytest.approx(6.25, abs=1e-6)
    assert clearance.clearance_mm == pytest.approx(6.25 - 0.4, abs=1e-6)
    crossing = Trajectory("B", face - 3 * u - 30 * v, face - 3 * u + 20 * v, CT, ELECTRODE)
    through = vessel.clearance(crossing)
    assert through is not None
    assert through.crosses


@pytest.mark.long
def test_distance_to_a_round_vessel_in_the_head_equals_its_closed_form() -> None:
    """As of vessels of all shapes in smaller scans, in `test_smooth`."""
    head = scanned("plain")
    shape = head.volume.voxels_hu.shape
    index = np.stack(np.meshgrid(*(np.arange(n, dtype=np.float64) for n in shape), indexing="ij"), axis=-1)
    middle, axis = np.array([20.0, 0, 25.0]), np.array([0.36, 0.8, 0.48])
    places = head.volume.grid.positions_mm(index) - middle
    mask = (places**2).sum(axis=-1) - (places @ axis) ** 2 < 4.0**2
    vessel = Voxels.of(Kind.NO_GO, "vessel", mask, head)
    across = np.cross(axis, [0, 0, 1.0]) / np.hypot(0.36, 0.8)
    for x in (-5.0, 0.3, 8.7):
        clearance = vessel.clearance(Trajectory("A", np.array([x, 0, 80]), np.array([x, 0, 5]), CT))
        assert clearance is not None
        true = abs(np.array([x - 20.0, 0, 0]) @ across) - 4.0
        assert clearance.smooth
        assert clearance.distance_mm == pytest.approx(true, abs=0.05)
        assert clearance.at_least_mm < true


def test_a_path_wholly_inside_a_no_go_region_meets_it() -> None:
    head = scanned("plain")
    mask = np.zeros(head.volume.voxels_hu.shape, dtype=np.bool_)
    mask[20:-5, 100:-100, 100:-100] = True
    clearance = Voxels.of(Kind.NO_GO, "all", mask, head).clearance(
        Trajectory("A", np.array([0.0, 0, 60]), np.array([0.0, 0, 20]), CT)
    )
    assert clearance is not None
    assert clearance.crosses


def test_metal_is_seen() -> None:
    """A wire of 3 mm along y through (20, 0, 10): 17 mm from its surface, less the voxels' own size."""
    head = scanned("plain", wire=True)
    trajectory = path(np.array([0.0, 0.0, 10.0]), np.array([0.0, 0.0, 1.0]))
    (clearance,) = measure(trajectory, head, obstacles=[metal(head)]).clearances
    assert clearance.kind is Kind.METAL
    assert clearance.distance_mm == pytest.approx(18.5, abs=0.8)


def test_distance_to_a_marker_counts_the_whole_instrument() -> None:
    """The sphere is met 40 mm outside the head, where the instrument still is."""
    target, outward = np.zeros(3), np.array([0.0, -1.0, 0.0])
    trajectory = path(target, outward)
    far = target + 130.0 * outward + np.array([12.0, 0.0, 0.0])
    marker = PostedMarker("F1", far, far + np.array([3.0, 0.0, 0.0]), 11.5)
    assert marker.clearance(trajectory).distance_mm == pytest.approx(12.0 - 5.75, abs=1e-9)
    post = PostedMarker("F2", np.array([60.0, -100.0, 0.0]), np.array([8.0, -84.0, 0.0]), 11.5)
    assert post.clearance(trajectory).distance_mm == pytest.approx(8.0 - POST_RADIUS_MM, abs=1e-9)


def test_a_marker_s_post_reaches_to_the_head_below_it() -> None:
    head = scanned("plain")
    (marker,) = markers_on(head, ("F1",), FOOT[np.newaxis] + [[0.0, -13.75, 0.0]], 11.5)
    assert np.linalg.norm(marker.foot_mm - FOOT) < 3.0


def test_distances_between_trajectories() -> None:
    head = scanned("plain")
    first = path(np.array([0.0, 0, 10]), np.array([0.0, 0, 1]), "A")
    second = path(np.array([15.0, 0, 10]), np.array([0.0, 0, 1]), "B")
    third = path(np.array([-30.0, 0, 10]), np.array([0.0, 0, 1]), "C")
    spacing, farther = measure(first, head, others=[first, second, third]).spacings
    assert (spacing.other, farther.other) == ("B", "C")
    assert farther.distance_mm == pytest.approx(30.0, abs=1e-9)
    assert spacing.distance_mm == pytest.approx(15.0, abs=1e-9)
    assert spacing.clearance_mm == pytest.approx(14.2, abs=1e-9)


def test_however_many_are_beside_a_trajectory_its_length_is_taken_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 200 each is held against all others after every change."""
    axis, taken = np.array([0.0, 0, 1]), list[str]()
    among = [path(np.array([x, 0, 10.0]), axis, f"E{x}") for x in range(-20, 20)]

    def length_mm(one: Trajectory) -> float:
        taken.append(one.name)
        return 1.0

    monkeypatch.setattr(Trajectory, "length_mm", property(length_mm))
    assert len(spacings(among[0], among)) == 39
    assert taken == ["E-20"]


def test_landmarks_give_ac_pc_angles() -> None:
    landmarks = Landmarks(np.array([0.0, -12, 0]), np.array([0.0, 12, 0]), np.array([0.0, 0, 40]))
    measured = measure(path(np.zeros(3), np.array([-0.6, 0, 0.8])), scanned("plain"), landmarks=landmarks)
    assert measured.acpc is not None
    assert measured.acpc.coronal_deg == pytest.approx(np.degrees(np.arctan2(0.6, 0.8)))
    assert measured.acpc.sagittal_deg == pytest.approx(90.0)


@pytest.mark.parametrize(
    ("entry", "target", "words"),
    [
        ([0, 0, 300], [0, 0, 10], "outside the scan"),
        ([0, 0, 80], [0, 0, -90], "outside the scan"),
        ([0, 0, 80], [80, 0, 10], "in air"),
        ([0, -93, 0], [0, 0, 10], "in air"),
    ],
)
def test_ends_outside_the_scan_or_in_air_are_refused(entry: list[float], target: list[float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        measure(Trajectory("A", np.array(entry), np.array(target), CT), scanned("plain"))


def test_a_trajectory_of_another_frame_is_refused() -> None:
    trajectory = path(np.zeros(3), np.array([0.0, 0, 1]))
    with pytest.raises(FrameMismatchError):
        measure(replace(trajectory, frame=Frame("CT", "9.9")), scanned("plain"))


@pytest.mark.parametrize(
    "options",
    [
        {"target_mm": np.array([0.0, 0, 80.2])},
        {"name": " "},
        {"colour": "orange"},
        {"entry_mm": np.array([np.nan, 0, 0])},
    ],
)
def test_an_impossible_trajectory_is_refused(options: dict[str, object]) -> None:
    settings: dict[str, object] = {"name": "A", "entry_mm": [0, 0, 80], "target_mm": [0, 0, 10]}
    with pytest.raises(InputError):
        Trajectory(**{**settings, **options})  # type: ignore[arg-type]


@few_and_others("stack", ["tilted", "uneven"], ["plain", "oblique"])
def test_an_obstacle_holds_exactly_its_voxels_and_lists_those_at_its_surface(stack: str) -> None:
    head = scanned(stack)
    generator = np.random.default_rng(5)
    shape = head.volume.voxels_hu.shape
    mask = np.zeros(shape, dtype=np.bool_)
    mask[:9] = generator.random((9, *shape[1:])) < 0.8  # at five faces of the scan
    mask[0, 0, 0] = True
    obstacle = Voxels.of(Kind.NO_GO, "speckle", mask, head)
    index = generator.integers([-2, -2, -2], [12, shape[1] + 2, shape[2] + 2], (3000, 3))
    inside = np.asarray(((index >= 0) & (index < shape)).all(axis=1))
    expected = inside & mask[tuple(np.where(inside[:, None], index, 0).T)]
    assert (obstacle.holds(head.volume.grid.positions_mm(index.astype(np.float64))) == expected).all()
    boundary = mask & ~binary_erosion(mask)
    centers_mm = head.volume.grid.positions_mm(np.argwhere(boundary).astype(np.float64))
    np.testing.assert_allclose(obstacle.centers_mm, centers_mm, rtol=0, atol=1.0)


def test_nothing_is_held_by_an_empty_obstacle() -> None:
    head = scanned("plain")
    empty = Voxels.of(Kind.NO_GO, "none", np.zeros(head.volume.voxels_hu.shape, dtype=np.bool_), head)
    assert not empty.holds(np.zeros((4, 3))).any()
