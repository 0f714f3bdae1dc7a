"""The rigid registration of one image to another by SimpleITK, as another process does it: for the eye only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.pose import transform_points
from ronnaplan.scene.field import Field

BINS, SHARE, SEED = 40, 0.25, 1
"""Of the mutual information (Mattes): bins, and which share of the cells is looked at."""

LEVELS: Final = ((4, 2.0), (2, 1.0), (1, 0.0))
"""Coarse to fine: every so many cells, after a blur of so many mm."""

ASIDE_DEG, ASIDE_MM = 4.0, 6.0
"""The second start is turned and moved so far from the first."""

REACH_MM = 70.0
"""Where both starts end is compared this far from the middle of the fixed image: the size of a head."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """``moving_from_fixed`` (4, 4) in LPS mm, and how far apart the results of two starts are in the head, mm."""

    moving_from_fixed: FloatArray
    apart_mm: float


def align(fixed: Field, moving: Field) -> Alignment:
    """Register ``moving`` to ``fixed`` twice, from the centers of mass and from aside; return the better result."""
    import SimpleITK as sitk

    images = [_image(sitk, one) for one in (fixed, moving)]
    first = sitk.CenteredTransformInitializer(
        *images, sitk.Euler3DTransform(), sitk.CenteredTransformInitializerFilter.MOMENTS
    )
    start = sitk.Euler3DTransform(first)
    aside = sitk.Euler3DTransform(first)
    turn, shift = np.radians(ASIDE_DEG), np.array(start.GetTranslation()) + ASIDE_MM / np.sqrt(3.0)
    aside.SetRotation(start.GetAngleX() + turn, start.GetAngleY() - turn, start.GetAngleZ() + turn)
    aside.SetTranslation(shift.tolist())
    found = sorted((_from(sitk, images, one) for one in (start, aside)), key=lambda one: one[0])
    middle = fixed.origin_mm + fixed.cell_mm * (np.array(fixed.values.shape[::-1]) - 1) / 2
    corners = middle + REACH_MM * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    both = [transform_points(pose, corners) for _, pose in found]
    return Alignment(found[0][1], float(np.linalg.norm(both[0] - both[1], axis=1).max()))


def _image(sitk: Any, field: Field) -> Any:
    image = sitk.GetImageFromArray(field.values)
    image.SetOrigin(field.origin_mm.tolist())
    image.SetSpacing([field.cell_mm] * 3)
    return image


def _from(sitk: Any, images: list[Any], start: Any) -> tuple[float, FloatArray]:
    """Return the metric (less is better) and the pose (4, 4) that one start ends at."""
    method = sitk.ImageRegistrationMethod()
    method.SetMetricAsMattesMutualInformation(BINS)
    method.SetMetricSamplingStrategy(method.REGULAR)
    method.SetMetricSamplingPercentage(SHARE, SEED)
    method.SetInterpolator(sitk.sitkLinear)
    method.SetOptimizerAsRegularStepGradientDescent(2.0, 1e-3, 200, 0.6)
    method.SetOptimizerScalesFromPhysicalShift()
    method.SetShrinkFactorsPerLevel([factor for factor, _ in LEVELS])
    method.SetSmoothingSigmasPerLevel([sigma for _, sigma in LEVELS])
    method.SmoothingSigmasAreSpecifiedInPhysicalUnitsOn()
    method.SetInitialTransform(start, inPlace=True)
    method.Execute(*images)
    pose = np.eye(4)
    pose[:3, :3] = np.array(start.GetMatrix()).reshape(3, 3)
    pose[:3, 3] = np.array(start.TransformPoint([0.0, 0.0, 0.0]))
    return float(method.GetMetricValue()), pose
