"""Stereo re-localization of one retro-reflective sphere: its center in R with its covariance."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from numbers import Real
from typing import TypeVar

import numpy as np

from ronnaplan.errors import InputError, RefusedError, check_type
from ronnaplan.geometry import FloatArray, Points, rms_mm
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import TCP, to_frame
from ronnaplan.robot.stereo.calibration_errors import errors_of, remedy
from ronnaplan.robot.stereo.camera import RIG, Camera, StereoRig
from ronnaplan.robot.stereo.circles import Image
from ronnaplan.robot.stereo.fields import require_one_moment
from ronnaplan.robot.stereo.lights import fit, in_each_light, weighed
from ronnaplan.robot.stereo.outline import Cone, Outline, find_cones, outlines_of
from ronnaplan.robot.stereo.response import require_linear
from ronnaplan.robot.stereo.shading_steps import ASIDE_SD
from ronnaplan.robot.stereo.sphere_refused import advice, left_open
from ronnaplan.sigmas import LARGEST_STATED_MM, SIGMA_LAMP_DEG

LARGEST_GAP_MM = 0.3
"""Two outlines whose lines of sight pass further from each other than this are not of one sphere."""
RIG_PX = 0.03
"""By so much the calibration makes lines of sight miss each other, which then tells nothing of the light."""
LARGEST_GAP_SDS = 4.0
"""Lines of sight that miss each other by more standard deviations, of both outlines' errors and the calibration's, are
not of one moment and of these cameras: what moved along the lines of sight's plane is seen by nothing."""
SIZE_TOLERANCE = 0.05
"""Largest relative difference of an outline's apparent size from that of the sphere at the place found."""
CONE_PX, CONE_SIZE = 10.0, 0.25
"""The same for cones that edges agree on: lines of sight may be off by so many pixels more, sizes by this."""
CENTERS = np.array([0, 1, 3, 4])
"""Of the places in two images, those of the center."""

Found = TypeVar("Found", Cone, Outline)


@dataclass(frozen=True, eq=False)
class StereoSphere:
    """The sphere found in both images."""

    position_mm: FloatArray
    """Center (3,) in the rig's frame."""
    covariance_mm2: FloatArray
    """Covariance (3, 3): what the outlines' noise and the cameras' calibration make of it."""
    calibration_mm2: FloatArray
    """What of it (3, 3) is the cameras' calibration; alike for spheres that are seen at like places. Zero where the rig
    does not tell what it was calibrated on. The error of ``tcp_from_rig`` is in neither."""
    gap_mm: float
    """How far the two lines of sight pass from each other."""
    gap_sds: float
    """The same in standard deviations, in the lights that may fall on it."""
    left: Outline
    right: Outline

    def size_errors(self, rig: StereoRig, diameter_mm: float) -> tuple[float, float]:
        """Return by what part a sphere of ``diameter_mm`` is farther, by its outline in either image, than found."""
        left, right = (
            outline.distance_mm(diameter_mm) / float(np.linalg.norm(self.position_mm - camera.center_mm)) - 1
            for camera, outline in ((rig.left, self.left), (rig.right, self.right))
        )
        return left, right

    def in_robot(self, rig: StereoRig, robot_from_tcp: Pose, label: str = "sphere") -> Points:
        """Return the center in R, with the errors of the outlines, of ``tcp_from_rig`` and of the robot's pose."""
        TCP.require(rig.tcp_from_rig.to_frame)
        here = Points(self.position_mm[None], self.covariance_mm2[None], (label,), RIG)
        return to_frame(robot_from_tcp @ rig.tcp_from_rig, here)


def locate_sphere(
    left: Image,
    right: Image,
    rig: StereoRig,
    *,
    diameter_mm: float,
    largest_mm: float = LARGEST_STATED_MM,
    lamp_sd_deg: float = SIGMA_LAMP_DEG,
) -> StereoSphere:
    """Return the one sphere of ``diameter_mm`` that both images (rows, columns; grey) show.

    Outlines are paired when their lines of sight meet and both have the size of such a sphere there. Raises
    `InputError` if no pair does and `RefusedError` if more than one does, if the images are not linear in the light or
    not of one moment, if the lines of sight miss each other by more than their errors, or if the center is not known to
    ``largest_mm`` (RMS), by the images and by the cameras' calibration. Where the limb is as dark as the ground its
    place depends on where the lamps are: well beside the lenses, or about them and off them by ``lamp_sd_deg``, as seen
    from the sphere.
    """
    _require_asked(rig, diameter_mm, largest_mm, lamp_sd_deg)
    with ThreadPoolExecutor(2) as pool:
        seen = list(pool.map(find_cones, (left, right), (rig.left, rig.right)))
        meeting = _that_may_meet(seen[0], seen[1], rig, diameter_mm)
        cones = meeting if meeting[0] else seen
        lefts, rights = pool.map(
            outlines_of, cones, (left, right), (rig.left, rig.right), (lamp_sd_deg, lamp_sd_deg)
        )
    met = [
        sphere for one in lefts for other in rights if (sphere := _meet(one, other, rig, lamp_sd_deg)) is not None
    ]
    found = [one for one in met if max(map(abs, one.size_errors(rig, diameter_mm))) <= SIZE_TOLERANCE]
    if not found:
        counts = f"{len(lefts)} outlines left, {len(rights)} right"
        kept = [few or many for few, many in zip((lefts, rights), seen, strict=True)]
        why = _other_size(met, rig, diameter_mm) or left_open(kept, rig, diameter_mm, largest_mm)
        why = why or advice(lefts, rights, bool(meeting[0]))
        raise InputError(f"no sphere of {diameter_mm:g} mm is seen by both cameras ({counts}){why}")
    _require_one(found, diameter_mm)
    both = (left, right), (rig.left, rig.right), (found[0].left, found[0].right)
    require_linear(*both)
    require_one_moment(*both)
    _require_met(found[0], rig)
    _require_known(found[0], rig, diameter_mm, largest_mm)
    return found[0]


def _require_asked(rig: StereoRig, diameter_mm: float, largest_mm: float, lamp_sd_deg: float) -> None:
    """Raise `UsageError` or `InputError` for what is no rig, no length above zero, and no lamp about a lens."""
    check_type(rig, StereoRig, "the cameras' rig", "calibrate_on_board returns one")
    check_type(diameter_mm, Real, "the sphere's diameter", "give a number of mm")
    check_type(largest_mm, Real, "the largest error", "give a number of mm")
    if not 0 < diameter_mm < np.inf or not largest_mm > 0:
        raise InputError(
            f"a sphere of {diameter_mm} mm was to be known to {largest_mm} mm; expected a diameter and an error above "
            "zero"
        )
    check_type(lamp_sd_deg, Real, "the lamp's angle", "give a number of degrees")
    largest_deg = float(np.degrees(ASIDE_SD))
    if not 0 < lamp_sd_deg <= largest_deg:
        raise InputError(
            f"the lamp is {lamp_sd_deg} degrees off the lens; expected above 0, up to {largest_deg:.3g} degrees"
        )


def _require_one(found: list[StereoSphere], diameter_mm: float) -> None:
    """Raise `RefusedError` where more than one sphere was ``found``."""
    if len(found) > 1:
        raise RefusedError(
            f"{len(found)} spheres of {diameter_mm:g} mm are seen by both cameras; expected one, so take the others "
            "out of sight"
        )


@dataclass(frozen=True, eq=False)
class _Missed:
    """How two lines of sight miss each other in each light (H)."""

    apart: FloatArray
    """What of the places in both images (4) no position explains."""
    by: FloatArray
    """(H,), rad."""
    variances: FloatArray
    """(H,), by outlines and a calibration of which nothing is told."""


def _require_met(sphere: StereoSphere, rig: StereoRig) -> None:
    """Raise `RefusedError` where the lines of sight to ``sphere`` miss each other by more than their errors."""
    if sphere.gap_sds > LARGEST_GAP_SDS:
        far_mm = float(np.linalg.norm(sphere.position_mm - rig.left.center_mm))
        gap_px = sphere.gap_mm / far_mm * rig.left.focal_px
        raise RefusedError(
            f"the lines of sight to the sphere miss each other by {gap_px:.2f} pixels, {sphere.gap_sds:.0f} times "
            "their standard error: something moved between left and right, or a camera since the calibration; take "
            "both at one moment, and calibrate the cameras anew if it stays"
        )


def _require_known(sphere: StereoSphere, rig: StereoRig, diameter_mm: float, largest_mm: float) -> None:
    """Raise `RefusedError` where the center of ``sphere`` is not known to ``largest_mm`` (RMS), and say why."""
    stated_mm, calibrated_mm = float(rms_mm(sphere.covariance_mm2)), float(rms_mm(sphere.calibration_mm2))
    if stated_mm <= largest_mm:
        return
    told = f"the sphere's center is known to {stated_mm:.4f} mm only; expected {largest_mm:g} mm or less: "
    if 2 * calibrated_mm**2 > stated_mm**2:
        raise RefusedError(
            f"{told}by {calibrated_mm:.4f} mm the cameras' calibration leaves open where it is; "
            f"{remedy(rig, sphere.position_mm, diameter_mm / 2)}"
        )
    raise RefusedError(
        f"{told}light the sphere evenly, brighter than what is behind it but not brighter than pixels get, let it rest "
        "in focus, or move the cameras closer"
    )


def _other_size(met: list[StereoSphere], rig: StereoRig, diameter_mm: float) -> str:
    """Say of what size the sphere is that was ``met`` where one of ``diameter_mm`` was expected, or nothing."""
    for one in met:
        left, right = (1 + error for error in one.size_errors(rig, diameter_mm))
        if abs(left / right - 1) <= SIZE_TOLERANCE:
            return (
                f", but what looks like one of {2 * diameter_mm / (left + right):.3g} mm: correct the diameter or the "
                "size of the squares that the cameras were calibrated with, or light the sphere to its limb, in focus, "
                "or, where that is none, put a plain and darker ground behind the one that is"
            )
    return ""


def _that_may_meet(
    lefts: list[Cone], rights: list[Cone], rig: StereoRig, diameter_mm: float
) -> tuple[list[Cone], list[Cone]]:
    """Return the cones that are of one sphere of ``diameter_mm`` with one of the other image."""
    may = np.zeros((len(lefts), len(rights)), dtype=bool)
    for i, left in enumerate(lefts):
        for j, right in enumerate(rights):
            near, gap_mm = _crossing(rig, left, right)
            far_mm = [float(np.linalg.norm(near - camera.center_mm)) for camera in (rig.left, rig.right)]
            blurred_mm = CONE_PX * (far_mm[0] / rig.left.focal_px + far_mm[1] / rig.right.focal_px)
            sizes = [
                one.distance_mm(diameter_mm) / far - 1 for one, far in zip((left, right), far_mm, strict=True)
            ]
            may[i, j] = gap_mm < LARGEST_GAP_MM + blurred_mm and max(map(abs, sizes)) < CONE_SIZE
    return [lefts[i] for i in np.flatnonzero(may.any(1))], [rights[j] for j in np.flatnonzero(may.any(0))]


def _crossing(rig: StereoRig, left: Found, right: Found) -> tuple[FloatArray, float]:
    """Return the position (3,) nearest to both lines of sight, and how far they pass from each other (mm)."""
    directions = np.array(
        [camera.rig_from_camera[:3, :3] @ one.direction for camera, one in _seen(rig, left, right)]
    )
    normal = np.cross(directions[0], directions[1])
    turn = float(np.linalg.norm(normal))
    if turn < 1e-3:
        return rig.left.center_mm, np.inf
    gap_mm = abs(float(normal @ (rig.right.center_mm - rig.left.center_mm))) / turn
    return _nearest(rig, directions), gap_mm


def _meet(left: Outline, right: Outline, rig: StereoRig, lamp_sd_deg: float) -> StereoSphere | None:
    near, gap_mm = _crossing(rig, left, right)
    ahead = all(
        (camera.rig_from_camera[:3, 2] @ (near - camera.center_mm)) > 0 for camera in (rig.left, rig.right)
    )
    if not ahead or gap_mm > LARGEST_GAP_MM:
        return None
    logarithms, places, covariances, gains, missed = _in_each_light(rig, left, right, near, lamp_sd_deg)
    position, seen = weighed(logarithms, places, covariances)
    calibration, open_gap = np.zeros((3, 3)), 0.0
    if (errors := errors_of(rig)) is not None:
        across = [one.sight.across for one in (left, right)]
        radius_mm = float(np.linalg.norm(near - rig.left.center_mm) * np.sin(left.half_angle))
        of_both = errors.of_places(rig, near, across, radius_mm)
        _, calibration = weighed(logarithms, np.zeros_like(places), gains @ of_both @ gains.transpose(0, 2, 1))
        open_gap = float(missed.apart @ of_both @ missed.apart)
    squares = missed.by**2 / (missed.variances + open_gap)
    gap_sds = float(np.sqrt(np.average(squares, weights=np.exp(logarithms - logarithms.max()))))
    return StereoSphere(position, seen + calibration, calibration, gap_mm, gap_sds, left, right)


def _seen(rig: StereoRig, left: Found, right: Found) -> tuple[tuple[Camera, Found], tuple[Camera, Found]]:
    return (rig.left, left), (rig.right, right)


def _nearest(rig: StereoRig, directions: FloatArray) -> FloatArray:
    """Return the position (3,) nearest to both lines of sight, of unit ``directions`` (2, 3)."""
    square = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    origins = np.array([rig.left.center_mm, rig.right.center_mm])
    return np.asarray(
        np.linalg.solve(square.sum(axis=0), np.einsum("sij,sj->i", square, origins)), dtype=np.float64
    )


def _in_each_light(
    rig: StereoRig, left: Outline, right: Outline, near: FloatArray, lamp_sd_deg: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, _Missed]:
    """Return the logarithm of each light's probability (H), and the position (H, 3) and covariance (H, 3, 3) in it.

    Then how the position follows the places in both images (H, 3, 4), and how the lines of sight miss. Minimizes what
    places are off, in units of their covariance, linear about the position ``near``. In the right light lines meet.
    """
    lights = in_each_light((left.sight, right.sight), lamp_sd_deg)
    seen = [one.sight.seen(near - camera.center_mm) for camera, one in _seen(rig, left, right)]
    slope = np.concatenate([slope for _, slope in seen])
    misfit = lights.places[:, CENTERS] - np.concatenate([place for place, _ in seen])
    spread = lights.covariances[:, CENTERS][:, :, CENTERS]
    weights = slope.T @ np.linalg.inv(spread)
    covariances = np.asarray(np.linalg.inv(weights @ slope), dtype=np.float64)
    gains = covariances @ weights
    moves = (gains @ misfit[:, :, None])[:, :, 0]
    apart = np.linalg.svd(slope)[0][:, 3]  # what no position explains
    missed = _Missed(
        apart,
        misfit @ apart,
        apart @ spread @ apart + RIG_PX**2 / (rig.left.focal_px * rig.right.focal_px),
    )
    logarithms = lights.logarithms + fit(missed.by[:, None], missed.variances[:, None, None])
    return logarithms, near + moves, covariances, gains, missed
