"""The report's trajectories: cuts, measures, distances, and what is wrong with a path."""

from __future__ import annotations

import numpy as np

from ronnaplan.errors import RonnaplanError
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head, Limits, Measures, Trajectory, judge, measure
from ronnaplan.planning.obstacles import Obstacle, markers_on, metal
from ronnaplan.planning.uncertainty import planned_pose_covariance
from ronnaplan.registration.markers import SIGMA_CT_MM
from ronnaplan.report.case import Case
from ronnaplan.report.html import element, picture, table
from ronnaplan.report.part import Part, number
from ronnaplan.report.path_cuts import path_picture
from ronnaplan.tracking.markers import ONE_READING_SD_MM

TITLE = "Trajectories"


def paths_part(case: Case) -> Part:
    """Measure and draw every trajectory of the plan in the scan."""
    if case.plan is None or not case.plan.trajectories:
        return Part(TITLE)
    if case.volume is None:
        return Part(
            TITLE, [table(("", "entry LPS mm", "target LPS mm", "length mm"), map(_ends, case.plan.trajectories))]
        )
    try:
        head = Head.of(case.volume)
    except RonnaplanError as error:
        return Part(TITLE, warnings=[f"the trajectories could not be measured: {error}"])
    obstacles, pose_mm2, warnings = _surroundings(case, head)
    part = Part(TITLE, warnings=warnings)
    for trajectory in case.plan.trajectories:
        part.body.append(element("h3", trajectory.name))
        try:
            measured = measure(
                trajectory,
                head,
                obstacles=obstacles,
                others=case.plan.trajectories,
                landmarks=case.plan.landmarks,
                pose_mm2=pose_mm2,
            )
        except RonnaplanError as error:
            part.warnings.append(f"trajectory {trajectory.name} could not be measured: {error}")
            continue
        part.body.append(
            picture(path_picture(case.volume, measured), f"{trajectory.name}: two cuts along the path")
        )
        part.body.append(table([], _measures(measured)))
        part.warnings.extend(_faults(measured))
    return part


def _surroundings(case: Case, head: Head) -> tuple[list[Obstacle], FloatArray | None, list[str]]:
    """Return what to keep away from, and the covariance of the registration that the markers will give."""
    obstacles: list[Obstacle] = [metal(head)]
    if case.fiducials is None or not case.fiducials.fiducials:
        return obstacles, None, []
    points = case.fiducials.points
    obstacles += markers_on(head, points.labels, points.positions_mm, case.fiducials.marker.diameter_mm)
    sigma_mm = float(np.hypot(SIGMA_CT_MM, ONE_READING_SD_MM))
    try:
        pose = planned_pose_covariance(points.positions_mm, points.covariances_mm2 + sigma_mm**2 * np.eye(3))
    except RonnaplanError as error:
        return obstacles, None, [f"no error can be expected of these markers: {error}"]
    return obstacles, pose, []


def _ends(trajectory: Trajectory) -> list[str]:
    return [
        trajectory.name,
        _place(trajectory.entry_mm),
        _place(trajectory.target_mm),
        f"{trajectory.length_mm:.2f}",
    ]


def _measures(one: Measures) -> list[tuple[str, str]]:
    path, error = one.trajectory, one.error
    rows = [
        ("entry, LPS mm", _place(path.entry_mm)),
        ("target, LPS mm", _place(path.target_mm)),
        (
            "instrument",
            f"{path.instrument.name}, {path.instrument.diameter_mm:g} x {path.instrument.length_mm:g} mm",
        ),
        ("length", f"{one.length_mm:.2f} mm"),
        ("target below scalp", f"{number(one.depth_below_scalp_mm)} mm"),
        ("target below skull", f"{number(one.depth_below_skull_mm)} mm"),
        ("bone along the path", f"{number(one.skull_thickness_mm)} mm"),
        ("angle to the skull's normal", f"{number(one.skull_angle_deg, 1)} deg"),
    ]
    rows += [
        (
            f"distance to {near.name}",
            f"{near.clearance_mm:.2f} mm (at least {near.at_least_mm:.2f}) at depth {near.depth_mm:.1f} mm",
        )
        for near in one.clearances
    ]
    rows += [
        (f"distance to {near.other}", f"{near.clearance_mm:.2f} mm at depth {near.depth_mm:.1f} mm")
        for near in one.spacings
    ]
    if error is not None:
        rows += [
            ("error expected of these markers, entry", f"{error.entry_rms_mm:.2f} mm RMS"),
            ("error expected of these markers, target", f"{error.target_rms_mm:.2f} mm RMS"),
            ("radius of the 95 % tube", f"at most {error.tube_mm.max():.2f} mm"),
            (f"chance to stay within {error.tolerance_mm:g} mm", f"{error.probability:.3f}"),
        ]
    return rows


def _faults(measured: Measures) -> list[str]:
    return [
        f"trajectory {one.trajectory}: {one.measure} {number(one.value)} {one.unit} {one.remark}".rstrip()
        for one in judge(measured, Limits())
        if not one.passes
    ]


def _place(place_mm: FloatArray) -> str:
    return ", ".join(f"{value:.2f}" for value in place_mm)
