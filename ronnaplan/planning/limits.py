"""Limits that a plan must keep, and the verdict on each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from numbers import Real

from ronnaplan.errors import InputError, UsageError, check_type
from ronnaplan.planning.contacts import nearest_contacts
from ronnaplan.planning.layers import Way
from ronnaplan.planning.lengths import TOLERANCE_MM
from ronnaplan.planning.measures import Measures
from ronnaplan.planning.obstacles import Clearance, Kind

NEAR_SHARE = 0.1
"""A limit that is kept by less than this share of it is nearly broken."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a trajectory must keep; None: not limited. Distances count from the instrument's surface.

    Of a distance that is known so far and no further, the least it may be is held against the limit. Errors are RMS
    over all axes; ``least_probability`` is of the chance that the path stays within ``tolerance_mm``. Raises
    `UsageError` for what is no finite number of zero or more.
    """

    longest_path_mm: float | None = None
    greatest_skull_angle_deg: float | None = None
    greatest_skull_thickness_mm: float | None = None
    least_no_go_distance_mm: float | None = None
    least_metal_distance_mm: float | None = None
    least_marker_distance_mm: float | None = None
    least_trajectory_distance_mm: float | None = None
    greatest_target_error_mm: float | None = None
    greatest_angular_error_deg: float | None = None
    least_probability: float | None = None
    tolerance_mm: float = TOLERANCE_MM

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if value is None and one.default is None:
                continue
            if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 <= float(value) < math.inf:
                unlimited = ", or None for no limit" if one.default is None else ""
                raise UsageError(f"{one.name} is {value!r}; expected a finite number of 0 or more{unlimited}")

    def least_distance_mm(self, kind: Kind) -> float:
        """Return the distance to keep from an obstacle; it must never be met, limit or not."""
        least = {
            Kind.NO_GO: self.least_no_go_distance_mm,
            Kind.METAL: self.least_metal_distance_mm,
            Kind.MARKER: self.least_marker_distance_mm,
        }[kind]
        return least or 0.0

    @property
    def near_trajectory_mm(self) -> float:
        """A trajectory no nearer than this to another one keeps their limit, and by more than `is_near` doubts."""
        return (1.0 + NEAR_SHARE) * (self.least_trajectory_distance_mm or 0.0)


@dataclass(frozen=True)
class Verdict:
    """One limit on one trajectory: ``value`` against ``limit``. A value that cannot be told does not pass."""

    trajectory: str
    measure: str
    value: float | None
    unit: str
    limit: float | None
    passes: bool
    remark: str = ""


def judge(measured: Measures, limits: Limits) -> tuple[Verdict, ...]:
    """Return the verdict on every limit for one trajectory.

    Beside the limits asked for: the way out of the head must be open, the instrument long enough, and nothing may
    be met. Raises `InputError` when a limit asks for something that was not measured (no markers, no label map).
    """
    check_type(measured, Measures, "what was measured", "measure returns it")
    check_type(limits, Limits, "the limits", "make them with Limits(longest_path_mm=80.0), say")
    return (*_shape(measured, limits), *_distances(measured, limits), *_errors(measured, limits))


def _shape(measured: Measures, limits: Limits) -> Iterator[Verdict]:
    name = measured.trajectory.name
    way = measured.crossings.way
    remark = {
        Way.OPEN: "",
        Way.CUT: "the path leaves the scan before the head ends",
        Way.COVERED: "something is attached to the head at the entry",
    }[way]
    yield Verdict(name, "way out of the head", None, "", None, way is Way.OPEN, remark)
    length = measured.trajectory.instrument.length_mm
    yield _at_most(name, "path within the instrument", measured.length_mm, "mm", length)
    bounds = (
        ("path length", measured.length_mm, "mm", limits.longest_path_mm),
        ("angle to skull normal", measured.skull_angle_deg, "deg", limits.greatest_skull_angle_deg),
        ("skull along the path", measured.skull_thickness_mm, "mm", limits.greatest_skull_thickness_mm),
    )
    for what, value, unit, limit in bounds:
        if limit is not None:
            yield _at_most(name, what, value, unit, limit)


def _distances(measured: Measures, limits: Limits) -> Iterator[Verdict]:
    name = measured.trajectory.name
    kinds = {one.kind for one in measured.clearances}
    if limits.least_no_go_distance_mm is not None and Kind.NO_GO not in kinds:
        raise InputError("the limits keep a distance from no-go regions but no label map is given; give one")
    if limits.least_marker_distance_mm is not None and Kind.MARKER not in kinds:
        raise InputError("the limits keep a distance from markers but no fiducials are given; give fiducials.json")
    for one in measured.clearances:
        yield _kept(name, f"distance to {one.name}", one, limits, _remark(one))
    for number, one in nearest_contacts(measured.contacts).values():
        yield _kept(name, f"contacts to {one.name}", one, limits, f"contact {number}{_sure(one)}")
    least_apart = limits.least_trajectory_distance_mm or 0.0
    for called, other in measured.named_spacings:
        passes = other.clearance_mm >= least_apart and other.clearance_mm > 0
        remark = f"at depth {other.depth_mm:.1f} mm"
        yield Verdict(name, f"distance to {called}", other.clearance_mm, "mm", least_apart, passes, remark)


def _kept(name: str, what: str, one: Clearance, limits: Limits, remark: str) -> Verdict:
    least = limits.least_distance_mm(one.kind)
    passes = one.at_least_mm >= least and not one.crosses
    return Verdict(name, what, one.clearance_mm, "mm", least, passes, remark)


def _remark(one: Clearance) -> str:
    if one.clearance_mm <= 0.0:
        return "met"
    return f"{'may be met, ' if one.crosses else ''}at depth {one.depth_mm:.1f} mm{_sure(one)}"


def _sure(one: Clearance) -> str:
    return f", at least {one.at_least_mm:.2f}" if one.at_least_mm < one.clearance_mm else ""


def _errors(measured: Measures, limits: Limits) -> Iterator[Verdict]:
    bounds = (limits.greatest_target_error_mm, limits.greatest_angular_error_deg, limits.least_probability)
    if all(bound is None for bound in bounds):
        return
    if measured.error is None:
        raise InputError(
            "the limits bound the expected error but there is nothing to expect it of; give fiducials.json "
            "with three markers or more, or a registration"
        )
    name, error, basis = measured.trajectory.name, measured.error, f"as {measured.error.expected.basis}"
    if bounds[0] is not None:
        yield _at_most(name, "expected error at target", error.target_rms_mm, "mm", bounds[0], basis)
    if bounds[1] is not None:
        yield _at_most(name, "expected angular error", error.angular_rms_deg, "deg", bounds[1], basis)
    if bounds[2] is not None:
        what = f"chance to stay within {error.tolerance_mm:g} mm"
        yield Verdict(name, what, error.probability, "", bounds[2], error.probability >= bounds[2], basis)


def _at_most(name: str, what: str, value: float | None, unit: str, limit: float, remark: str = "") -> Verdict:
    if value is None:
        remark = "could not be measured"
    return Verdict(name, what, value, unit, limit, value is not None and value <= limit, remark)


def is_near(verdict: Verdict) -> bool:
    """Tell whether a limit is kept by so little that it should be looked at.

    That is `NEAR_SHARE` of it, and where it is a chance, of what is left to certainty.
    """
    value, limit = verdict.value, verdict.limit
    if not verdict.passes or value is None or limit is None:
        return False
    return abs(value - limit) <= NEAR_SHARE * (abs(limit) if verdict.unit else 1.0 - limit)


def all_pass(verdicts: Sequence[Verdict]) -> bool:
    """Whether every verdict passes."""
    return all(verdict.passes for verdict in verdicts)
