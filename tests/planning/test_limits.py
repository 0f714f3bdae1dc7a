"""A limit that is broken is told; one that cannot be judged is never taken as kept."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from ronnaplan.errors import InputError, UsageError
from ronnaplan.geometry import Frame
from ronnaplan.planning import Instrument, Limits, Measures, Trajectory, judge, measure
from ronnaplan.planning.apart import Spacing
from ronnaplan.planning.limits import Verdict, is_near
from ronnaplan.planning.obstacles import Clearance, Kind
from ronnaplan.planning.rows import distance_rows
from ronnaplan.planning.uncertainty import Basis, ExpectedPose, path_error
from tests.planning.heads import SCALP, scanned

LIMITS = Limits(longest_path_mm=60.0, greatest_skull_angle_deg=30.0, greatest_skull_thickness_mm=10.0)


@pytest.fixture(scope="module")
def measured() -> Measures:
    target = np.array([0.0, 0, 30])
    entry = np.array([0.0, 0, SCALP[2]])
    return measure(Trajectory("A", entry, target, Frame("CT", "1.2.3")), scanned("plain"))


def broken(measured: Measures, limits: Limits) -> list[str]:
    return [verdict.measure for verdict in judge(measured, limits) if not verdict.passes]


def test_a_good_path_keeps_all(measured: Measures) -> None:
    assert broken(measured, LIMITS) == []


@pytest.mark.parametrize(
    ("limits", "what"),
    [
        (Limits(longest_path_mm=49.9), "path length"),
        (Limits(greatest_skull_angle_deg=0.001), "angle to skull normal"),
        (Limits(greatest_skull_thickness_mm=5.8), "skull along the path"),
    ],
)
def test_each_limit_can_be_broken(measured: Measures, limits: Limits, what: str) -> None:
    assert broken(measured, limits) == [what]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0, "80", True])
def test_a_limit_that_is_no_number_is_refused_for_against_some_all_paths_would_pass(value: Any) -> None:
    with pytest.raises(UsageError, match=r"longest_path_mm is .*; expected a finite number of 0 or more, or None"):
        Limits(longest_path_mm=value)
    with pytest.raises(UsageError, match=r"tolerance_mm is None; .* 0 or more$"):
        Limits(tolerance_mm=cast("float", None))


def test_an_instrument_that_is_too_short(measured: Measures) -> None:
    short = replace(measured.trajectory, instrument=Instrument("short", 1.0, 49.0))
    assert broken(replace(measured, trajectory=short), LIMITS) == ["path within the instrument"]


def test_nothing_may_be_met_even_without_a_limit(measured: Measures) -> None:
    vessel = Clearance(Kind.NO_GO, "vessel", 0.3, -0.2, 12.0, -0.2)
    assert broken(replace(measured, clearances=(vessel,)), Limits()) == ["distance to vessel"]
    clear = Clearance(Kind.NO_GO, "vessel", 3.0, 2.5, 12.0, 2.5)
    assert broken(replace(measured, clearances=(clear,)), Limits()) == []
    assert broken(replace(measured, clearances=(clear,)), Limits(least_no_go_distance_mm=2.6)) != []


def test_a_trajectory_that_has_the_name_of_a_marker_is_told_from_it(measured: Measures) -> None:
    """The markers of a template are A, B and so on, as electrodes are."""
    marker, path = Clearance(Kind.MARKER, "A", 9.0, 8.5, 2.0, 8.5), Spacing("A", 4.0, 3.0, 30.0)
    beside = replace(measured, clearances=(marker,), spacings=(path, Spacing("B", 7.0, 6.0, 1.0)))
    told = {one.measure: one.value for one in judge(beside, Limits()) if one.measure.startswith("distance")}
    assert told == {"distance to A": 8.5, "distance to trajectory A": 3.0, "distance to B": 6.0}
    assert [what for what, _ in distance_rows(beside)] == list(told)


def test_of_a_distance_that_is_not_known_exactly_the_least_is_held_against_the_limit(measured: Measures) -> None:
    vessel = Clearance(Kind.NO_GO, "vessel", 3.0, 2.5, 12.0, 2.3, smooth=True)
    near = replace(measured, clearances=(vessel,))
    assert broken(near, Limits(least_no_go_distance_mm=2.2)) == []
    assert broken(near, Limits(least_no_go_distance_mm=2.4)) == ["distance to vessel"]
    (verdict,) = (one for one in judge(near, Limits()) if one.measure == "distance to vessel")
    assert verdict.value == 2.5
    assert verdict.remark == "at depth 12.0 mm, at least 2.30"
    perhaps = replace(measured, clearances=(replace(vessel, at_least_mm=-0.1),))
    assert broken(perhaps, Limits()) == ["distance to vessel"]


@pytest.mark.parametrize(
    "limits",
    [
        Limits(least_no_go_distance_mm=1.0),
        Limits(least_marker_distance_mm=1.0),
        Limits(greatest_target_error_mm=1.0),
        Limits(least_probability=0.9),
    ],
)
def test_a_limit_on_what_was_not_given_is_an_error(measured: Measures, limits: Limits) -> None:
    with pytest.raises(InputError, match="give"):
        judge(measured, limits)


def test_a_missing_skull_does_not_pass(measured: Measures) -> None:
    boneless = replace(measured, crossings=replace(measured.crossings, outer=None, inner=None))
    assert broken(boneless, LIMITS) == ["angle to skull normal", "skull along the path"]


def test_limits_on_the_expected_error(measured: Measures) -> None:
    covariance = np.diag([1e-6, 1e-6, 1e-6, 0.1, 0.1, 0.1])
    expected = ExpectedPose(covariance, Basis.REGISTERED, ("F1", "F2", "F3"), 0.56, 0.17)
    known = replace(measured, error=path_error(measured.trajectory, expected, 1.0))
    assert broken(known, Limits(greatest_target_error_mm=0.6, greatest_angular_error_deg=0.1)) == []
    assert broken(known, Limits(greatest_target_error_mm=0.5)) == ["expected error at target"]
    assert broken(known, Limits(greatest_angular_error_deg=0.05)) == ["expected angular error"]
    assert broken(known, Limits(least_probability=0.999)) == ["chance to stay within 1 mm"]
    (verdict,) = [one for one in judge(known, Limits(greatest_target_error_mm=0.6)) if "expected" in one.measure]
    assert verdict.remark == "as registered"


@pytest.mark.parametrize(
    ("value", "unit", "limit", "near"),
    [
        (91.0, "mm", 100.0, True),
        (89.0, "mm", 100.0, False),
        (101.0, "mm", 100.0, False),
        (2.15, "mm", 2.0, True),
        (0.952, "", 0.95, True),
        (0.96, "", 0.95, False),
        (None, "", None, False),
    ],
)
def test_a_limit_that_is_kept_by_a_tenth_is_near(
    value: float | None, unit: str, limit: float | None, near: bool
) -> None:
    passes = value is None or limit is None or (value <= limit if limit > 50 else value >= limit)
    assert is_near(Verdict("A", "any", value, unit, limit, passes)) is near
