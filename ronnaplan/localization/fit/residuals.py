"""What a fitted ball leaves of its voxels, and how its model changes with its parameters, or a cavity's place."""

from __future__ import annotations

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.ball import Discs, discs
from ronnaplan.localization.fit.model import evaluate, leave_over
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import CENTER, PARAMETERS

ALIKE_VOXELS = 6.0
"""Noise is alike in so many neighbouring voxels, which tell no more than one (5 to 12, by 230 balls of 60 scans)."""


def residuals_and_jacobian(
    around: Neighbourhood, theta: FloatArray, layer_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Data minus model (N,) and the Jacobian (N, P); both zero where clipped data agree with a model beyond."""
    voxels = around.offsets_mm, around.values_hu, around.floors_hu
    return _left_over(*voxels, theta, layer_mm, discs(theta), around.ceiling_hu)


@njit(cache=True, nogil=True)
def _left_over(
    offsets: FloatArray,
    values: FloatArray,
    floors: FloatArray,
    theta: FloatArray,
    layer_mm: float,
    looked_up: Discs,
    ceiling: float,
) -> tuple[FloatArray, FloatArray]:
    left_over, jacobian = evaluate(offsets, theta, layer_mm, *looked_up)
    leave_over(values, floors, ceiling, jacobian, left_over)
    return left_over, jacobian


def layer_jacobian(around: Neighbourhood, theta: FloatArray, layer_mm: float) -> FloatArray:
    """How the model changes (N, 3) with the place of the second ball alone, of a hollow or wrapped marker, HU/mm."""
    alone: FloatArray = _second_ball(around.offsets_mm, theta, layer_mm)[1][:, CENTER]
    return alone


def cavity_moved_hu(around: Neighbourhood, theta: FloatArray, layer_mm: float, aside_mm: FloatArray) -> FloatArray:
    """How the model changes (N,) where the second ball alone lies ``aside_mm`` (3,) from the center, HU."""
    aside, there = (
        _second_ball(offsets_mm, theta, layer_mm)[0]
        for offsets_mm in (around.offsets_mm - aside_mm, around.offsets_mm)
    )
    moved_hu: FloatArray = aside - there
    return moved_hu


def _second_ball(offsets_mm: FloatArray, theta: FloatArray, layer_mm: float) -> tuple[FloatArray, FloatArray]:
    """What the second ball of a hollow or wrapped marker adds to the model (N,), and to its derivatives (N, P)."""
    without = theta.copy()
    without[len(PARAMETERS)] = 0.0
    both, first = (evaluate(offsets_mm, one, layer_mm, *discs(one)) for one in (theta, without))
    return both[0] - first[0], both[1] - first[1]
