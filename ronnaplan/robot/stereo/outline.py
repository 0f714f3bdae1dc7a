"""The outline of a bright sphere in one image, and the direction to its center.

A sphere's outline lies on a circular cone about the line from the camera to its center, so its image is an ellipse
whose center is *not* the image of the sphere's center. The cone is therefore fitted to the outline's undistorted
rays, which gives the direction to the center without that bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.circles import SMALLEST_RADIUS_PX, Image, find_circles
from ronnaplan.robot.stereo.lights import MODELED_SHADOW_PX, SHADOW_PX, Sight, by_turning, in_each_light, weighed
from ronnaplan.robot.stereo.pixel_noise import noise_on
from ronnaplan.robot.stereo.shading import ShadedSphere, find_shaded, in_own_shadow
from ronnaplan.robot.stereo.shading_compiled import Flags
from ronnaplan.robot.stereo.specks import without_specks
from ronnaplan.sigmas import SIGMA_LAMP_DEG

CONSENSUS_PX = 2.0
"""A first outline is the one that most edges lie as near to, so that hidden or spoilt parts do not pull it."""
FLOOR_PX = 0.01
"""What the model of the sphere errs in a sector at best."""
LARGEST_SD_PX = 0.5
"""Sectors that know their edge worse are left out."""
SMALLEST_COVERAGE = 0.5
"""Share of the outline that must agree with the cone; the rest may be hidden or spoilt by a reflection."""
LARGEST_RMS_PX = 0.3
"""Points that scatter more about their outline are no sphere's."""
LARGEST_OVAL_PX = 0.15
"""Points of a flat disc's outline go in a wave about a cone: more than this, beyond its error, is no sphere's."""
WAVES = (2, 3, 4)
LARGEST_FIRST_WAVE = 4.0
"""Where the light is not in the model, the wave of one period, which moves the center, is larger than those of more,
by up to this factor (squared), as on balls lit from aside whose brightness does not fall off as the cosine."""
BY_PART, OVEREXPOSED_SHARE = 4.0, 0.1
"""Errors are counted so many times (squared) where a ball's light is told by a part of it, as more than this share is
brighter than pixels get, its middle is not in the model, or specks lie on it: what of its light is not leaves no misfit
there, but moves the center. So are they where the whole leaves more than noise and no part of it is clean: what is left
is alike from pixel to pixel then, as the edge of its shadow on a near ground, or noise that compression smoothed."""
LENS_FALL, LENS_SHARE = 4, 3**-0.5
"""A lens makes what is off its axis darker by up to this power of the cosine: by anything from none to all of it, of
which the second is the RMS."""
SHADOWED, SHADOW_TILT, SHADOW_COVERAGE = 2.5, 0.05, 0.65
"""A sphere is looked at as one in its own shadow where its errors are larger than noise by this factor (squared). It is
held to be so where they are smaller then by as much, and not larger than noise by as much, where its light is else
tilted by less than this share, and where this share of its outline agrees: several lamps, or light that does not fall
off as the cosine, are not in the model, and show so."""
NOISY = 1.1
"""A ball that leaves more than so many times the noise of its pixels shows what its model lacks, as a highlight in its
middle: beside it light has no more noise. Its rim is believed instead where that leaves less."""
DARK = 0.9
"""Yet not where the rim is so much darker at the limb than in the middle: lit from aside, uneven and moved it looks the
same, and that the ball is even would be believed of what nothing shows."""


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


@dataclass(frozen=True, eq=False)
class _Judged:
    """How well the model of a sphere explains its outline."""

    kept: Flags
    """Sectors (S) that know their edge."""
    excess: float
    """By so much their errors are larger than the noise alone makes them, squared; at least 1."""


def find_outlines(image: Image, camera: Camera) -> list[Outline]:
    """Return every outline in ``image`` (rows, columns; grey) that could be a bright sphere's, largest first.

    A lamp about the lens is off it by `SIGMA_LAMP_DEG`, as seen from the sphere. Raises as `find_cones` does.
    """
    return outlines_of(find_cones(image, camera), image, camera, SIGMA_LAMP_DEG)


def find_cones(image: Image, camera: Camera) -> list[Cone]:
    """Return every cone in ``image`` (rows, columns; grey) that edges agree on, best supported first.

    Raises `InputError` for an image that is not two-dimensional or not finite, or not of the camera's size.
    """
    small = image.ndim != 2 or min(image.shape) < 4 * SMALLEST_RADIUS_PX
    if small or (image.dtype.kind == "f" and not np.isfinite(image).all()):
        raise InputError(
            f"a camera image has shape {image.shape}; expected grey values (rows, columns), all finite"
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

    A sphere whose light is not in the model, or that something spoils, is looked at in three more ways: as one in its
    own shadow; by its rim alone, most of which a cable or a highlight in the middle leaves clean; and without what is
    finer on it than light, as dust all over.
    """
    expected = grey, camera, cone.direction, cone.half_angle, cone.rays
    whole = _judged(find_shaded(*expected))
    if whole is not None and whole[1].excess > SHADOWED:
        again = _judged(in_own_shadow(whole[0]))
        if again is not None and _is_in_shadow(*again, whole[1].excess):
            return again[0], _doubted(*again)
    largest = np.inf  # of what a rim may leave
    if whole is not None and whole[1].excess <= SHADOWED:
        largest = NOISY * _noise_of(whole[0], grey, camera)
        if whole[0].noise <= largest:
            return whole[0], _doubted(*whole)
    rim = _judged(find_shaded(*expected, rim_only=True))
    instead = bool(np.isfinite(largest))  # of a whole that is believed else
    if rim is not None and _is_clean(rim[1]) and rim[0].noise <= largest and not (instead and rim[0].dark > DARK):
        return rim[0], _doubted(*rim, by_part=instead)
    cleaned = _without_specks(grey, cone, camera)
    if cleaned is not None:
        return cleaned[0], _doubted(*cleaned, by_part=True)
    return None if whole is None else (whole[0], _doubted(*whole, by_part=instead))


def _without_specks(grey: Image, cone: Cone, camera: Camera) -> tuple[ShadedSphere, _Judged] | None:
    """Return the sphere near ``cone`` by what is beside specks on it, where that leaves no more than noise."""
    ball = camera.pixels(cone.direction[None])[0], cone.half_angle * camera.focal_px
    noise = noise_on(grey, *ball)
    cleaned = without_specks(grey, *ball, noise) if np.isfinite(noise) else None
    if cleaned is None:
        return None
    found = _judged(find_shaded(cleaned, camera, cone.direction, cone.half_angle, cone.rays))
    if found is None or not _is_clean(found[1]) or found[0].noise > NOISY * noise or found[0].dark > DARK:
        return None
    return found


def _doubted(found: ShadedSphere, told: _Judged, *, by_part: bool = False) -> float:
    """Return by how much the errors of a sphere are larger than noise, squared; it may be told ``by_part`` of it."""
    return told.excess * (BY_PART if by_part or found.clipped_share > OVEREXPOSED_SHARE else 1.0)


def _noise_of(found: ShadedSphere, grey: Image, camera: Camera) -> float:
    """Return the noise of the pixels of a sphere."""
    middle_px = camera.pixels(_toward(found, found.place)[None])[0]
    return noise_on(grey, middle_px, float(found.place[2]) * camera.focal_px)


def _judged(found: ShadedSphere | None) -> tuple[ShadedSphere, _Judged] | None:
    """Return a sphere with how well its model explains the outline, or None where there is none."""
    told = None if found is None else _judge(found)
    return None if found is None or told is None else (found, told)


def _is_clean(told: _Judged) -> bool:
    """Tell whether a part of a ball shows no more than noise, on so much of the outline that it is a sphere's."""
    return told.excess < SHADOWED and float(told.kept.mean()) > SHADOW_COVERAGE


def _sight(found: ShadedSphere, excess: float, camera: Camera) -> Sight:
    """Return the sphere ``found``, whose errors (squared) are larger than noise by ``excess``, in the rig's frame."""
    turn = camera.rig_from_camera[:3, :3]
    told, doubt = (np.array([1.0, 0.0]), np.zeros((2, 2))) if found.shadows else by_turning(found.profile)
    return Sight(
        turn @ found.expected,
        turn @ found.across,
        found.place,
        found.light,
        excess * found.covariance,
        np.outer(told, told) + doubt,
        LENS_FALL * LENS_SHARE * found.place[2] * found.across[2] / found.expected[2],
        (MODELED_SHADOW_PX if found.shadows else SHADOW_PX) * found.dark,
        camera.focal_px,
    )


def _is_in_shadow(found: ShadedSphere, told: _Judged, excess: float) -> bool:
    """Tell whether a sphere ``found`` with its own shadow is one, where without it the errors have this ``excess``."""
    return (
        told.excess < min(excess / SHADOWED, SHADOWED)
        and float(np.hypot(*found.light[:2])) < SHADOW_TILT
        and float(told.kept.mean()) > SHADOW_COVERAGE
    )


def _judge(found: ShadedSphere) -> _Judged | None:
    """Return how well a sphere's model explains the outline, or None where this is no sphere's."""
    kept = found.kept & (found.sds_px < LARGEST_SD_PX)
    if kept.sum() < SMALLEST_COVERAGE * len(kept):
        return None
    turn, shifts, sds = found.angles[kept], found.shifts_px[kept], np.hypot(found.sds_px[kept], FLOOR_PX)
    rms_px = float(np.sqrt((shifts**2).mean()))
    waves, covariance = _waves(turn, shifts, sds)
    if rms_px > LARGEST_RMS_PX + 3 * float(np.sqrt((sds**2).mean())):
        return None
    if np.linalg.norm(waves[:2]) > LARGEST_OVAL_PX + 3 * np.sqrt(np.trace(covariance[:2, :2])):
        return None
    scatter = float(((shifts / sds) ** 2).sum()) / (kept.sum() - 3)
    excess = max(scatter, float(waves @ np.linalg.solve(covariance, waves)) / len(waves), 1.0)
    return _Judged(kept, excess * min(max(excess / SHADOWED, 1.0), LARGEST_FIRST_WAVE))


def _toward(found: ShadedSphere, place: FloatArray) -> FloatArray:
    """Return the unit direction (3,) of a ``place`` (3) along its axes."""
    axis: FloatArray = found.expected + found.across @ place[:2]
    return axis / np.linalg.norm(axis)


def _waves(turn: FloatArray, shifts: FloatArray, sds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how much ``shifts`` (N) go in waves of two, three and four periods about the axis (6), and the covariance.

    An error of the light shifts the edge slowly along the outline. What of it has one period shifts the center and is
    not seen; it is taken to be as large as those of more. On a part of the outline waves look like each other, so that
    by their covariance only it is told how large they are.
    """
    columns = [wave(k * turn) for k in WAVES for wave in (np.cos, np.sin)]
    design = np.column_stack([np.ones_like(turn), np.cos(turn), np.sin(turn), *columns]) / sds[:, None]
    covariance = np.asarray(np.linalg.inv(design.T @ design), dtype=np.float64)
    return (covariance @ design.T @ (shifts / sds))[3:], covariance[3:, 3:]


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
