"""Where an arm's links are, and how its tool moves with the joints; for many joint vectors at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, as_numbers
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.transforms import exponential, rigid

LENGTH_MM = 300.0
"""What a radian counts for beside a length, where both are measured as one: a tool's usual length."""


def as_angles(arm: SerialArm, angles_rad: ArrayLike) -> FloatArray:
    """Return ``angles_rad`` (..., N) as an array; raises `InputError` for another length or what is not finite."""
    angles = as_numbers(angles_rad, "joint angles", f"finite ones in rad, (..., {len(arm)})")
    if angles.ndim == 0 or angles.shape[-1] != len(arm) or not np.isfinite(angles).all():
        raise InputError(
            f"joint angles of shape {angles.shape} were given; expected finite ones in rad, (..., {len(arm)}) for the "
            f"joints of {arm.name}"
        )
    return angles


def link_frames(arm: SerialArm, angles_rad: ArrayLike) -> FloatArray:
    """Return base from link (..., N + 1, 4, 4), the base itself first, for ``angles_rad`` (..., N)."""
    angles = as_angles(arm, angles_rad)
    frames = np.empty((*angles.shape[:-1], len(arm) + 1, 4, 4))
    frames[..., 0, :, :] = np.eye(4)
    for n, (origin, axis) in enumerate(zip(arm.origins, arm.axes, strict=True)):
        turn = rigid(exponential(angles[..., n, None] * axis), np.zeros((*angles.shape[:-1], 3)))
        frames[..., n + 1, :, :] = frames[..., n, :, :] @ origin @ turn
    return frames


def forward(arm: SerialArm, angles_rad: ArrayLike, tool: str | None = None) -> FloatArray:
    """Return base from ``tool`` (..., 4, 4), or from the flange, for ``angles_rad`` (..., N)."""
    reached: FloatArray = link_frames(arm, angles_rad)[..., -1, :, :] @ _last_from(arm, tool)
    return reached


def jacobian(arm: SerialArm, angles_rad: ArrayLike, tool: str | None = None) -> FloatArray:
    """Return d(xi)/d(angles) (..., 6, N) of the tool: rotation in rad, then translation in mm of the tool's origin.

    Both are along the base's axes; the translation is that of the tool's origin itself ("local, world-aligned").
    """
    frames = link_frames(arm, angles_rad)
    tip_mm = (frames[..., -1, :, :] @ _last_from(arm, tool))[..., :3, 3]
    moved = frames[..., 1:, :, :]
    axes = np.einsum("...nij,nj->...ni", moved[..., :3, :3], arm.axes)
    swept = np.cross(axes, tip_mm[..., None, :] - moved[..., :3, 3])
    return np.concatenate([axes, swept], axis=-1).swapaxes(-1, -2)


def _last_from(arm: SerialArm, tool: str | None) -> FloatArray:
    return arm.flange if tool is None else arm.flange @ arm.tool(tool)
