"""The outline of a bright sphere in one image, and the direction to its center.

A sphere's outline lies on a circular cone about the line from the camera to its center, so its image is an ellipse
whose center is *not* the image of the sphere's center. The cone is therefore fitted to the outline's undistorted
rays, which gives the direction to the center without that bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeGuard

import numpy as np

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.agreement import QUARTER, SHADOWED, Judged, is_clean, judge
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.circles import SMALLEST_RADIUS_PX, Image, find_circles
from ronnaplan.robot.stereo.lights import MODELED_SHADOW_PX, SHADOW_PX, Sight, by_turning, in_each_light, weighed
from ronnaplan.robot.stereo.pixel_noise import noise_on
from ronnaplan.robot.stereo.shading import ShadedSphere, find_shaded
from ronnaplan.robot.stereo.shading_again import before_near_ground, in_own_lights, in_own_shadow
from ronnaplan.robot.stereo.shading_pixels import Part
from ronnaplan.robot.stereo.specks import without_specks
from ronnaplan.sigmas import SIGMA_LAMP_DEG

CONSENSUS_PX = 2.0
"""A first outline is the one that most edges lie as near to, so that hidden or spoilt parts do not pull it."""
BY_PART, OVEREXPOSED_SHARE = 4.0, 0.1
"""Errors are counted so many times (squared) where a ball's light is told by a part of it, as more than this share is
brighter than pixels get, its middle is not in the model, or specks lie on it: what of its light is not leaves no misfit
there, but moves the center. So are they where the whole leaves more than noise and no part of it is clean: what is left
is alike from pixel to pixel then, as the edge of its shadow on a near ground, or noise that compression smoothed."""
LENS_FALL, LENS_SHARE = 4, 3**-0.5
"""A lens makes what is off its axis darker by up to this power of the cosine: by anything from none to all of it, of
which the second is the RMS."""
SHADOW_TILT, SHADOW_COVERAGE = 0.05, 0.65
"""A sphere is looked at as one in its own shadow where its errors are larger than noise by `SHADOWED`. It is held to be
so where they are smaller then by as much, and not larger than noise by as much, where its light is else tilted by less
than this share, and where this share of its outline agrees: several lamps, or light that does not fall off as the
cosine, are not in the model, and show so."""
NOISY = 1.1
"""A ball that leaves more than so many times the noise of its pixels shows what its model lacks, as a highlight in its
middle: beside it light has no more noise. Its rim is believed instead where that leaves less."""
NO_BALL, SMOOTH_PX = 4.5, 2
"""What leaves more than so many times the noise of pixels so far apart is none. Beside each other pixels of compressed
images seem to have less: by JPEG of quality 75 balls leave 4 to 8 times of that, and 2 to 3.5 of this."""
DARK = 0.9
"""Yet not where the rim is so much darker at the limb than in the middle: lit from aside, uneven and moved it looks the
same, and that the ball is even would be believed of what nothing shows."""
BRIGHT_GROUND, SHIFTED = 0.1, 3.0
"""A ground that is brighter than this share of the ball, on average, may bend, as in the ball's shadow, and shift the
edge. It is looked at near the edge only where its place is another than by more than its errors (squared, in units of
their covariance)."""
LIMB_SDS = 4.0
"""A limb that is darker than nothing by more standard deviations is none: before a ground that is brighter than it, the
dark ring between both is explained as well by an outline that is too large, by a pixel or two, and beside its place."""
GROUND_LEFT = 0.1
"""Of what the ground farther out shifts the place by, so much may be left by what is near: it bends there, too."""


@dataclass(frozen=True, eq=False)
class _Seen:
    """Where a sphere is seen."""

    direction: FloatArray
    """Unit direction (3,) from the camera to the sphere's center, in the camera's own frame."""
    half_angle: float
    """Half the angle (rad) under which the sphere is seen."""

    def distance_mm(self, diameter_mm: float) -> float:
        """Return how far from the camera the center of a sphere of ``diameter_mm`` is."""
        return float(diameter_mm / 2 / np.sin(self.half_angle))

    def in_image(self, camera: Camera) -> tuple[FloatArray, float]:
        """Return its center (2,), column and row, and its radius in the image of ``camera``, px."""
        return camera.pixels(self.direction[None])[0], self.half_angle * camera.focal_px


@dataclass(frozen=True, eq=False)
class Cone(_Seen):
    """A circular cone of rays that edges agree on: where a sphere's outline may be, to some pixels."""

    rays: FloatArray
    """Unit directions (N, 3) to the edges on it."""


@dataclass(frozen=True, eq=False)
class Outline(_Seen):
    """One sphere-like outline."""

    sight: Sight
    """Where the sphere is in any light; direction and half-angle are those in all lights that may fall on it."""


def find_outlines(image: Image, camera: Camera) -> list[Outline]:
    """Return every outline in ``image`` (rows, columns; grey) that could be a bright sphere's, largest first.

    A lamp about the lens is off it by `SIGMA_LAMP_DEG`, as seen from the sphere. Raises as `find_cones` does.
    """
    return outlines_of(find_cones(image, camera), image, camera, SIGMA_LAMP_DEG)


def find_cones(image: Image, camera: Camera) -> list[Cone]:
    """Return every cone in ``image`` (rows, columns; grey) that edges agree on, best supported first.

    Raises `UsageError` for what is no array, `InputError` for what is no grey image, all finite, of the camera's size.
    """
    check_type(image, np.ndarray, "a camera's image", "give its grey values as an array (rows, columns)")
    small, kind = image.ndim != 2 or min(image.shape) < 4 * SMALLEST_RADIUS_PX, image.dtype.kind
    if small or kind not in "uif" or (kind == "f" and not np.isfinite(image).all()):
        raise InputError(
            f"a camera image has shape {image.shape} of {image.dtype}; expected grey values (rows, columns), all finite"
        )
    camera.require_size(image.shape)
    return [_consensus(camera.rays(circle.edges_px), camera) for circle in find_circles(image)]


def outlines_of(cones: list[Cone], image: Image, camera: Camera, lamp_sd_deg: float) -> list[Outline]:
    """Return the outlines at those of the ``cones`` where there is a bright sphere's, largest first."""
    outlines = [_outline(image, cone, camera, lamp_sd_deg) for cone in cones]
    return sorted((one for one in outlines if one is not None), key=lambda one: -one.half_angle)


def _outline(grey: Image, cone: Cone, camera: Camera, lamp_sd_deg: float) -> Outline | None:
    """Return the outline near ``cone``, if it is a sphere's."""
    fitted = _fitted(grey, cone, camera)
    if fitted is None:
        return None
    found, excess = fitted
    sight = _sight(found, excess, camera)
    lights = in_each_light([sight], lamp_sd_deg)
    place, _ = weighed(lights.logarithms, lights.places, lights.covariances)
    return Outline(_toward(found, place), float(place[2]), sight)


def _fitted(grey: Image, cone: Cone, camera: Camera) -> tuple[ShadedSphere, float] | None:
    """Return the sphere near ``cone`` and by how much its errors are larger than noise, or None where there is none.

    A sphere whose light is not in the model, or that something spoils, is looked at in five more ways: by its limb in
    any light; as one in its own shadow; by its rim alone, most of which a cable or a highlight in the middle leaves
    clean; without what is finer on it than light, as dust all over; and by its limb alone, from the cone on.
    """
    ball = cone.in_image(camera)
    noise, most = noise_on(grey, *ball), NO_BALL * noise_on(grey, *ball, apart=SMOOTH_PX)
    expected = camera, cone.direction, cone.half_angle, cone.rays
    found = _before_its_ground(find_shaded(grey, *expected), noise)
    whole = _judged(found, most)
    if found is not None and (whole is None or whole[1].excess > SHADOWED):
        other = _in_other_light(found, whole, most)
        if other is not None:
            return other[0], _doubted(*other)
    largest = np.inf  # of what a rim may leave
    if whole is not None and whole[1].excess <= SHADOWED:
        largest = NOISY * noise
        if whole[0].noise <= largest:
            return whole[0], _doubted(*whole)
    rim = _judged(_before_its_ground(find_shaded(grey, *expected, Part.RIM), noise), most)
    instead = bool(np.isfinite(largest))  # of a whole that is believed else
    if rim is not None and is_clean(rim[1]) and rim[0].noise <= largest and not (instead and rim[0].dark > DARK):
        return rim[0], _doubted(*rim, by_part=instead)
    cleaned = without_specks(grey, *ball, noise) if np.isfinite(noise) else None
    if cleaned is not None:
        beside = _judged(_before_its_ground(find_shaded(cleaned, *expected), noise), most)
        if _is_lit_and_clean(beside) and beside[0].noise <= NOISY * noise:
            return beside[0], _doubted(*beside, by_part=True)
    if not _shines_less_than_nothing(found) and not (whole is not None and is_clean(whole[1])):
        limb = _at_limb(find_shaded(grey, *expected, Part.LIMB), most)
        if limb is not None:
            return limb[0], _doubted(*limb)
    return None if whole is None else (whole[0], _doubted(*whole, by_part=instead))


def _at_limb(found: ShadedSphere | None, most: float) -> tuple[ShadedSphere, Judged] | None:
    """Return the sphere ``found`` by its limb, or, where that is in no light of the model, by it in any light."""
    limb = _judged(found, most)
    if found is not None and (limb is None or limb[1].excess > SHADOWED):
        limb = _judged(in_own_lights(found), most)
        if limb is not None and not is_clean(limb[1], QUARTER):
            return None
    return limb if _is_lit_and_clean(limb) else None


def _is_lit_and_clean(part: tuple[ShadedSphere, Judged] | None) -> TypeGuard[tuple[ShadedSphere, Judged]]:
    """Tell whether a ``part`` of a ball shows hardly more than noise, and its limb is not as dark as the ground."""
    return part is not None and is_clean(part[1]) and part[0].dark <= DARK


def _in_other_light(
    found: ShadedSphere, whole: tuple[ShadedSphere, Judged] | None, most: float
) -> tuple[ShadedSphere, Judged] | None:
    """Return the sphere ``found`` in a light that is not in its model, or None where it is in no such.

    By its limb, in whatever light, where that is neither dark nor shows more than noise; or in its own shadow, if the
    ``whole`` of it is a sphere's. One lamp's shadow knows more where it is one lamp's; else it is elsewhere than the
    limb.
    """
    near = _judged(in_own_lights(found), most) if found.noise <= most else None
    limb = near if _is_lit_and_clean(near) else None
    shaded = None if whole is None else _judged(in_own_shadow(found), most)
    if whole is None or shaded is None or not _is_in_shadow(*shaded, whole[1].excess):
        return limb
    if limb is None:
        return shaded
    apart = shaded[0].place[:2] - limb[0].place[:2]
    errors = limb[1].excess * limb[0].covariance[:2, :2]
    return limb if apart @ np.linalg.solve(errors, apart) > SHIFTED else shaded


def _before_its_ground(found: ShadedSphere | None, noise: float) -> ShadedSphere | None:
    """Return the sphere ``found`` by the ground near it, where what is farther out shifts it or leaves more.

    The latter is asked where more is left than the ``noise`` of its pixels, of which a darker ground has less.
    """
    if found is None:
        return None
    noisy = found.noise > noise
    near = before_near_ground(found) if noisy or found.ground > BRIGHT_GROUND else None
    if near is None:
        return found
    shifted = float(near.by_ground @ np.linalg.solve(near.covariance[:3, :3], near.by_ground))
    return near if shifted > SHIFTED or (noisy and near.noise < found.noise) else found


def _doubted(found: ShadedSphere, told: Judged, *, by_part: bool = False) -> float:
    """Return by how much the errors of a sphere are larger than noise, squared; it may be told ``by_part`` of it."""
    return told.excess * (BY_PART if by_part or found.clipped_share > OVEREXPOSED_SHARE else 1.0)


def _judged(found: ShadedSphere | None, most: float) -> tuple[ShadedSphere, Judged] | None:
    """Return a sphere with how well its model explains the outline, or None where there is none.

    What leaves more than ``most`` of its pixels is no ball, as a ring, whose edge alone may be one's; nor is one
    whose limb shines less than nothing before a bright ground.
    """
    if found is None or found.noise > most or _shines_less_than_nothing(found):
        return None
    told = judge(found)
    return None if told is None else (found, told)


def _shines_less_than_nothing(found: ShadedSphere | None) -> bool:
    """Tell whether a sphere's limb is darker than nothing before a bright ground, so that its outline is too large."""
    return found is not None and found.limb_sds < -LIMB_SDS and found.ground > BRIGHT_GROUND


def _sight(found: ShadedSphere, excess: float, camera: Camera) -> Sight:
    """Return the sphere ``found``, whose errors (squared) are larger than noise by ``excess``, in the rig's frame."""
    turn = camera.rig_from_camera[:3, :3]
    covariance = excess * found.covariance
    covariance[:3, :3] += GROUND_LEFT**2 * np.outer(found.by_ground, found.by_ground)
    told, doubt = (np.array([1.0, 0.0]), np.zeros((2, 2))) if found.shadows else by_turning(found.profile)
    return Sight(
        turn @ found.expected,
        turn @ found.across,
        found.place,
        found.light,
        covariance,
        np.outer(told, told) + doubt,
        LENS_FALL * LENS_SHARE * found.place[2] * found.across[2] / found.expected[2],
        (MODELED_SHADOW_PX if found.shadows else SHADOW_PX) * found.dark,
        camera.focal_px,
    )


def _is_in_shadow(found: ShadedSphere, told: Judged, excess: float) -> bool:
    """Tell whether a sphere ``found`` with its own shadow is one, where without it the errors have this ``excess``."""
    return (
        told.excess < min(excess / SHADOWED, SHADOWED)
        and float(np.hypot(*found.light[:2])) < SHADOW_TILT
        and float(told.kept.mean()) > SHADOW_COVERAGE
    )


def _toward(found: ShadedSphere, place: FloatArray) -> FloatArray:
    """Return the unit direction (3,) of a ``place`` (3) along its axes."""
    axis: FloatArray = found.expected + found.across @ place[:2]
    return axis / np.linalg.norm(axis)


def _consensus(rays: FloatArray, camera: Camera) -> Cone:
    """Return the cone that most ``rays`` (N, 3) lie near to.

    The cone is sought among those through three rays a third of the outline apart: the tips of unit rays on a cone lie
    in one plane.
    """
    third, tolerance = len(rays) // 3, CONSENSUS_PX / camera.focal_px
    normals = np.cross(np.roll(rays, third, axis=0) - rays, np.roll(rays, -third, axis=0) - rays)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    heights = (normals * rays).sum(axis=1, keepdims=True)
    told = lengths > 0  # of two rays that are one, no cone is
    axes = np.copysign(1.0, heights) * np.divide(normals, lengths, where=told, out=np.zeros_like(normals))
    half_angles = np.arccos(
        np.clip(np.divide(np.abs(heights), lengths, where=told, out=np.ones_like(heights)), 0, 1)
    )
    cosines = axes @ rays.T
    near = (cosines < np.cos(np.maximum(half_angles - tolerance, 0))) & (cosines > np.cos(half_angles + tolerance))
    best = int(near.sum(axis=1).argmax())
    return Cone(axes[best], float(half_angles[best, 0]), rays[near[best]])
