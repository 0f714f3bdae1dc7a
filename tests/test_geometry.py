"""Points that cannot be places in mm are refused before anything is computed with them."""

from typing import Any

import numpy as np
import pytest

from ronnaplan.bounds import FARTHEST_POINT_MM
from ronnaplan.correspondence import describe_layout, match_points
from ronnaplan.errors import InputError, RonnaplanError
from ronnaplan.geometry import Frame, Points, as_points, first_apart, rms_mm
from ronnaplan.planning import ExpectedPose, Landmarks, Trajectory
from ronnaplan.pose import as_pose
from ronnaplan.registration import predict_tre, radius_95_mm, register_markers, register_points
from ronnaplan.robot import calibrate_pivot, robot_pose, seen_tool
from ronnaplan.robot.chain import M
from ronnaplan.tracking import PointReading, Recording, ToolReading, find_markers, labelled_frames
from tests.registration import scene


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ([[1 + 2j, 0, 0]], "complex"),
        ([["1", "2", "1_0"]], "not numbers"),
        ([[True, False, True]], "not numbers"),
        (np.array([["1", "2", "1_0"]], object), "not numbers"),
        (np.zeros((1, 3), "datetime64[s]"), "not numbers"),
        (np.zeros((2, 3), dtype=complex), "complex"),
        (np.ma.masked_greater(np.eye(3), 0.5), "masked in part"),
        ([[0, 0, 0], [0, 1e300, 0]], "row 1.*millimetres"),
        ([[0, -1.01 * FARTHEST_POINT_MM, 0]], "row 0.*millimetres"),
        ([[0, 0, 10**400]], "not numbers"),
    ],
)
def test_what_is_no_place_in_mm_is_refused(values: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        as_points(values)  # type: ignore[arg-type]


def test_a_place_that_is_too_far_is_called_by_its_name_alone() -> None:
    """A person typed it: there are no rows."""
    for far in (1e300, np.nan):
        with pytest.raises(InputError, match=r"the target of left is \[0.0, .*, 0.0\]"):
            Trajectory("left", np.zeros(3), np.array([0.0, far, 0.0]))
    with pytest.raises(InputError, match="AC has shape"):
        Landmarks(np.zeros(2), np.zeros(3), np.zeros(3))


@pytest.mark.parametrize(
    ("wrong", "says"), [(1 + 0j, "complex"), (np.ma.masked, "masked in part"), ("a", "not numbers")]
)
def test_numbers_that_are_not_real_or_not_all_there_are_refused_wherever_they_stand(wrong: Any, says: str) -> None:
    """What lies beneath a mask counted, and of complex numbers the real part, with a warning."""
    errors: Any = np.ma.array(np.tile(np.eye(3), (6, 1, 1)))
    pose: Any = np.ma.array(np.eye(4))
    if wrong is not np.ma.masked:
        errors, pose = (np.asarray(values.astype(type(wrong))) for values in (errors, pose))
    errors[0, 0, 0] = pose[0, 3] = wrong
    for refuse in (
        lambda: register_points(scene.HEAD, scene.HEAD, errors),
        lambda: predict_tre(scene.HEAD, errors, scene.HEAD),
        lambda: radius_95_mm(errors),
        lambda: match_points(scene.HEAD, scene.HEAD, covariances_ct_mm2=errors),
        lambda: match_points(scene.HEAD, scene.HEAD, sigma_ots_mm=errors[:, 0, 0]),
        lambda: as_pose(pose),
        lambda: calibrate_pivot([pose] * 10 if isinstance(wrong, str) else np.ma.stack([pose] * 10)),
    ):
        with pytest.raises(InputError, match=says):
            refuse()


POINTS: dict[str, tuple[dict[str, Any], str]] = {
    "not finite": ({"positions_mm": np.nan * scene.HEAD}, "row 0"),
    "flat": ({"positions_mm": scene.HEAD[:, :2]}, r"expected \(N, 3\)"),
    "covariances not finite": ({"covariances_mm2": np.full((5, 3, 3), np.inf)}, "not finite"),
    "covariances below zero": ({"covariances_mm2": -np.tile(np.eye(3), (5, 1, 1))}, "not symmetric and positive"),
    "covariances askew": ({"covariances_mm2": np.tile(np.triu(np.ones((3, 3))), (5, 1, 1))}, "not symmetric"),
    "variances": ({"covariances_mm2": np.ones(5)}, r"shape \(5,\)"),
    "words": ({"covariances_mm2": "small"}, "not numbers"),
}


@pytest.mark.parametrize("name", POINTS)
def test_points_that_are_none_or_whose_errors_are_none_are_refused_where_they_are_made(name: str) -> None:
    """They went through every room: a drift check ended in NumPy's error, a chain stated negative variances."""
    wrong, says = POINTS[name]
    whole: dict[str, Any] = {
        "positions_mm": scene.HEAD,
        "covariances_mm2": np.tile(np.eye(3), (len(scene.HEAD), 1, 1)),
        "labels": tuple("abcde"),
    }
    with pytest.raises(InputError, match=says):
        Points(**(whole | wrong))


def test_points_keep_what_they_were_given() -> None:
    """A buffer that is filled again moved the reference of a drift check along."""
    buffer, errors = scene.HEAD.copy(), np.tile(np.eye(3), (len(scene.HEAD), 1, 1))
    points = Points(buffer, errors, tuple("abcde"))
    buffer += 5.0
    errors *= 0.0
    np.testing.assert_array_equal(points.positions_mm, scene.HEAD)
    np.testing.assert_array_equal(points.covariances_mm2[0], np.eye(3))
    listed: Any = scene.HEAD.tolist()
    assert Points(listed, points.covariances_mm2, tuple("abcde")).positions_mm.shape == (5, 3)


@pytest.mark.parametrize("sigma", [-0.1, float("nan"), float("inf"), 1e300, "small", np.full(5, 0.1), None])
def test_a_standard_deviation_that_is_none_is_refused_wherever_one_is_stated(sigma: Any) -> None:
    """Below zero it counted as its square, and what is not finite spread into the answer."""
    markers = scene.ct_points()
    one = Recording("test", (PointReading(0, scene.HEAD[0], "A"),))
    geometry = Points(markers.positions_mm, markers.covariances_mm2, markers.labels, M)
    resting = Recording("test", (), (ToolReading(0, "tool", np.eye(4) + np.eye(4, k=3) * 50),))
    for refuse in (
        lambda: register_markers(markers, scene.readings(), sigma_ct_mm=sigma),
        lambda: find_markers(one, sigma_mm=sigma),
        lambda: labelled_frames(one, scene.readings(), sigma_mm=sigma),
        lambda: ExpectedPose.planned(markers, sigma),
        lambda: ExpectedPose.planned(markers, 0.5, sigma),
        lambda: describe_layout(scene.HEAD).refusal_probability(sigma),
        lambda: seen_tool(resting, geometry, sigma_mm=sigma),
        lambda: robot_pose(np.eye(4), sigma),
        lambda: robot_pose(np.eye(4), 0.03, sigma),
    ):
        with pytest.raises(RonnaplanError, match="error"):
            refuse()


def test_a_registration_neither_takes_nor_predicts_at_coordinates_beyond_reason() -> None:
    found = register_points(scene.HEAD, scene.HEAD @ scene.TURN.T + scene.SHIFT)
    with pytest.raises(InputError, match="millimetres"):
        found.tre([[1e300, 0, 0]])
    with pytest.raises(InputError, match="millimetres"):
        register_points(1e298 * scene.HEAD, scene.HEAD)


class Counted(np.ndarray):
    """Places (N, 3) that count how often some of them are taken."""

    taken = 0

    def __getitem__(self, key: Any) -> Any:
        Counted.taken += 1
        return np.asarray(super().__getitem__(key))


def test_thousands_of_places_are_looked_through_without_taking_each_pair_of_them() -> None:
    lattice = 5.0 * np.stack(np.meshgrid(*[np.arange(14.0)] * 3), axis=-1).reshape(-1, 3)
    places = np.concatenate([lattice, lattice + 1.0])
    kept = first_apart(places.view(Counted), 2.0)
    np.testing.assert_array_equal(places[kept], lattice)
    assert len(places) <= Counted.taken <= 4 * len(places)


def test_exact_points_have_no_error_and_are_copied_whatever_their_number() -> None:
    given = np.array([[1.0, 2, 3], [4, 5, 6]])
    for count in (0, 2):
        points = Points.exact(given[:count], ("A", "B")[:count], Frame("CT", "1.2"))
        given[:] = 0.0
        assert (len(points), points.labels, points.frame.uid) == (count, ("A", "B")[:count], "1.2")
        assert points.covariances_mm2.shape == (count, 3, 3)
        assert not points.covariances_mm2.any()
        given[:] = [[1.0, 2, 3], [4, 5, 6]]
    assert points.positions_mm.tolist() == given.tolist()


def test_the_rms_length_of_an_error_is_over_all_three_axes_of_any_stack() -> None:
    rng = np.random.default_rng(8)
    root = rng.normal(size=(2, 5, 3, 3))
    errors = np.einsum("abij,abnj->abni", root, rng.normal(size=(2, 5, 20_000, 3)))
    seen = np.sqrt((errors**2).sum(axis=-1).mean(axis=-1))
    np.testing.assert_allclose(rms_mm(root @ root.swapaxes(-1, -2)), seen, rtol=0.03)


def test_labelled_points_and_tables_of_other_columns_are_refused_with_what_to_give() -> None:
    """NumPy would take a table's columns for x, y, z in the order in which they stand: a rotated head fits as well."""
    pd: Any = pytest.importorskip("pandas")
    places = scene.ct_points().positions_mm
    table = pd.DataFrame(places, columns=["x_mm", "y_mm", "z_mm"])
    assert as_points(table).tolist() == as_points(table.rename(columns={"x_mm": "R"})).tolist() == places.tolist()
    for other in (table[["z_mm", "x_mm", "y_mm"]], table.assign(label="F1")):
        with pytest.raises(InputError, match=r"table\[\['x_mm', 'y_mm', 'z_mm'\]\]"):
            as_points(other)
    with pytest.raises(InputError, match="give their positions_mm"):
        match_points(scene.ct_points(), scene.readings())  # type: ignore[arg-type]


def test_points_take_any_list_of_labels_and_say_what_is_none() -> None:
    given: Any = (range(2), np.array(["0", "1"]), [0, 1])
    assert {Points.exact(np.eye(3)[:2], labels, Frame("CT")).labels for labels in given} == {("0", "1")}
    wrong: Any = ((None, Frame("CT"), "labels"), (("A", "B"), "CT", "frame"))
    for labels, frame, says in wrong:
        with pytest.raises(RonnaplanError, match=f"the points' {says}"):
            Points.exact(np.eye(3)[:2], labels, frame)
