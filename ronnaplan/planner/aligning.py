"""The rigid registration of one image to another by SimpleITK, as another process does it: for the eye only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.scene.field import Field
from ronnaplan.text import printable
from ronnaplan.transforms import transform_points

BINS, SHARE, SEED = 40, 0.25, 1
"""Of the mutual information (Mattes): bins, and which share of the cells is looked at."""

LEVELS: Final = ((4, 2.0), (2, 1.0), (1, 0.0))
"""Coarse to fine: every so many cells, after a blur of so many mm."""

ASIDE_DEG, ASIDE_MM = 4.0, 6.0
"""The second start is turned and moved so far from the first."""

REACH_MM = 70.0
"""Where both starts end is compared this far from the middle of the fixed image: the size of a head."""


SIDES: Final = ("left and right", "front and back", "top and bottom")
"""What a header exchanges that has the sign of x, y or z wrong."""

EVERY: Final = 2
"""Every so many cells along each axis tell which of two ways to turn the moving image fits better."""

LEAST_GAIN: Final = 0.02
"""Sides are taken for exchanged where the image tells by this share more with them. Of heads that were their own mirror
images, which tell nothing of it, it told up to 0.010 more; of mirrored ones (CT, as MR, as PET) 0.033 to 1.
"""


@dataclass(frozen=True, eq=False)
class Alignment:
    """``moving_from_fixed`` (4, 4) in LPS mm, and how far apart the results of two starts are in the head, mm.

    ``exchanged`` are those of `SIDES` that, exchanged in the moving image, would have it fit better.
    """

    moving_from_fixed: FloatArray
    apart_mm: float
    exchanged: tuple[str, ...] = ()


def align(fixed: Field, moving: Field) -> Alignment:
    """Register ``moving`` to ``fixed`` twice, from the centers of mass and from aside; return the better result.

    Raises `InputError` for images of which SimpleITK finds nothing to compare.
    """
    import SimpleITK as sitk

    try:
        return _aligned(sitk, fixed, moving)
    except RuntimeError as error:  # all that SimpleITK raises
        reason = printable(str(error).strip().rpartition("\n")[2])
        raise InputError(
            f"SimpleITK cannot register the second image to the scan ({reason}); give one that shows the same head"
        ) from error


def _aligned(sitk: Any, fixed: Field, moving: Field) -> Alignment:
    images = [_image(sitk, one) for one in (fixed, moving)]
    start, aside = _start(sitk, images), _start(sitk, images)
    turn, shift = np.radians(ASIDE_DEG), np.array(start.GetTranslation()) + ASIDE_MM / np.sqrt(3.0)
    aside.SetRotation(start.GetAngleX() + turn, start.GetAngleY() - turn, start.GetAngleZ() + turn)
    aside.SetTranslation(shift.tolist())
    found = sorted((_from(sitk, images, one, LEVELS) for one in (start, aside)), key=lambda one: one[0])
    middle = fixed.origin_mm + fixed.cell_mm * (np.array(fixed.values.shape[::-1]) - 1) / 2
    corners = middle + REACH_MM * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    both = [transform_points(pose, corners) for _, pose in found]
    pose = found[0][1]
    return Alignment(pose, float(np.linalg.norm(both[0] - both[1], axis=1).max()), _exchanged(sitk, images, pose))


def _exchanged(sitk: Any, images: list[Any], pose: FloatArray) -> tuple[str, ...]:
    """Return which sides, exchanged in the moving image, have it tell notably more of the fixed one.

    A head fits its mirror image, or itself upside down, well enough for both starts to end at one place. Each way is
    tried coarsely, that which fits best of them more finely.
    """
    fixed, moving = images
    shown = _seen_in(sitk, fixed, moving, pose)

    def gain(signs: tuple[float, ...], levels: Sequence[tuple[int, float]]) -> float:
        """Return by what share more the image tells with the ``signs`` (3,) of its axes."""
        other = _flipped(sitk, moving, np.array(signs))
        try:
            _, there = _from(sitk, [fixed, other], _start(sitk, [fixed, other]), levels)
        except RuntimeError:  # SimpleITK's, where too little of both overlaps
            return -np.inf
        return _gain(_cells(sitk, fixed), _seen_in(sitk, fixed, other, there), shown)

    ways = [signs for signs in product((1.0, -1.0), repeat=3) if min(signs) < 0]
    best = max(ways, key=lambda signs: gain(signs, LEVELS[:1]))
    if gain(best, LEVELS[:-1]) <= LEAST_GAIN:
        return ()
    return tuple(side for side, sign in zip(SIDES, best, strict=True) if sign < 0)


def _gain(fixed: FloatArray, seen: FloatArray, shown: FloatArray) -> float:
    """Return by what share ``seen`` tells more of ``fixed`` than ``shown``, where both are there; cells (nz, ny, nx).

    What little a part of an image shares with air would count as much else.
    """
    both = np.isfinite(shown) & np.isfinite(seen)
    told = _shared(fixed[both], shown[both]) if both.any() else 0.0
    return _shared(fixed[both], seen[both]) / told - 1.0 if told > 0 else -np.inf


def _seen_in(sitk: Any, fixed: Any, moving: Any, pose: FloatArray) -> FloatArray:
    """Return ``moving`` on cells of ``fixed``, not a number where it shows nothing."""
    motion = sitk.AffineTransform(pose[:3, :3].ravel().tolist(), pose[:3, 3].tolist())
    return _cells(sitk, sitk.Resample(moving, fixed, motion, sitk.sitkLinear, float("nan")))


def _cells(sitk: Any, image: Any) -> FloatArray:
    found: FloatArray = sitk.GetArrayViewFromImage(image)[::EVERY, ::EVERY, ::EVERY].astype(np.float64)
    return found


def _shared(one: FloatArray, other: FloatArray) -> float:
    """Return the mutual information of two images' values (N,) in nats."""
    counts = np.histogram2d(one, other, bins=BINS)[0]
    chances = counts / max(counts.sum(), 1.0)
    alone = chances.sum(axis=1, keepdims=True) * chances.sum(axis=0, keepdims=True)
    some = chances > 0
    return float(np.sum(chances[some] * np.log(chances[some] / alone[some])))


def _image(sitk: Any, field: Field) -> Any:
    image = sitk.GetImageFromArray(field.values)
    image.SetOrigin(field.origin_mm.tolist())
    image.SetSpacing([field.cell_mm] * 3)
    return image


def _flipped(sitk: Any, image: Any, signs: FloatArray) -> Any:
    """Return an image as a header would show it that has the ``signs`` (3,) of its axes, about its middle."""
    turned = sitk.Image(image)
    to_middle = np.array(image.GetSpacing()) * (np.array(image.GetSize()) - 1) / 2
    turned.SetDirection(np.diag(signs).ravel().tolist())
    turned.SetOrigin((np.array(image.GetOrigin()) + to_middle - signs * to_middle).tolist())
    return turned


def _start(sitk: Any, images: list[Any]) -> Any:
    """Return the motion that brings both centers of mass together."""
    moments = sitk.CenteredTransformInitializerFilter.MOMENTS
    return sitk.Euler3DTransform(sitk.CenteredTransformInitializer(*images, sitk.Euler3DTransform(), moments))


def _from(
    sitk: Any, images: list[Any], start: Any, levels: Sequence[tuple[int, float]]
) -> tuple[float, FloatArray]:
    """Return the metric (less is better) and the pose (4, 4) that one start ends at."""
    method = sitk.ImageRegistrationMethod()
    method.SetMetricAsMattesMutualInformation(BINS)
    method.SetMetricSamplingStrategy(method.REGULAR)
    method.SetMetricSamplingPercentage(SHARE, SEED)
    method.SetInterpolator(sitk.sitkLinear)
    method.SetOptimizerAsRegularStepGradientDescent(2.0, 1e-3, 200, 0.6)
    method.SetOptimizerScalesFromPhysicalShift()
    method.SetShrinkFactorsPerLevel([factor for factor, _ in levels])
    method.SetSmoothingSigmasPerLevel([sigma for _, sigma in levels])
    method.SmoothingSigmasAreSpecifiedInPhysicalUnitsOn()
    method.SetInitialTransform(start, inPlace=True)
    method.Execute(*images)
    pose = np.eye(4)
    pose[:3, :3] = np.array(start.GetMatrix()).reshape(3, 3)
    pose[:3, 3] = np.array(start.TransformPoint([0.0, 0.0, 0.0]))
    return float(method.GetMetricValue()), pose
