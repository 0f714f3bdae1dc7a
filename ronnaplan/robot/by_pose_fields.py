"""What errors that depend on the robot's pose add to the poses of a hand-eye recording, and in which units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.between_frames import moving
from ronnaplan.robot.by_pose import Cause, Suspicion
from ronnaplan.transforms import adjoint, cross_matrix, invert

ALIKE = 10.0
"""Variance of what is alike in all poses, in that of what differs: over a recording an arm's axes and reach, and the
way to the tracker, change little."""
LEAST_SPREAD = 0.01
"""Places that lie nearer together, in parts of their distance from the tracker, tell nothing of its scale."""
LEAST_SHOWN = 30.0
"""So many times its noise has to be what places show of a scale: of a tool that swings about its tip that is noise."""


class Fields(NamedTuple):
    """Fields by their causes, and what one of the first unknown is worth of those that tell a size."""

    added: dict[Cause, FloatArray]
    """(N, 6, s): what the unknowns, each of about unit size, add to the poses of M."""
    share: float
    """Of distances, of a scale."""
    delay: float
    """In frames."""

    def in_units(self, suspicion: Suspicion) -> Suspicion:
        """Return ``suspicion`` of these fields with its scale as a share of distances, and its delay in frames."""
        return suspicion._replace(
            scale=suspicion.scale * self.share,
            scale_sd=suspicion.scale_sd * self.share,
            delay=suspicion.delay * self.delay,
            delay_sd=suspicion.delay_sd * self.delay,
        )


def fields(
    ots_from_m: FloatArray,
    robot_from_m: FloatArray,
    robot_from_tcp: FloatArray,
    sds: FloatArray,
    frames: Sequence[int],
) -> Fields:
    """Return what each cause adds to the poses of M.

    Poses are (N, 4, 4), all three as the robot tells them: the tracker's have the noise that is judged, and a scale of
    100 % leaves none of it. What is added is in M's axes, and in ``sds`` (6,) of its noise. That of a scale is what one
    standard deviation of places, over `spread_mm`, adds where the tracker tells distances too long. That of a delay is
    what so much of a frame adds as moves M by one standard deviation, where the tracker's poses are late (`moving`).
    """
    places = robot_from_tcp[:, :3, 3]
    usual = np.sqrt((places**2).sum(axis=1).mean())
    alike = np.full((len(places), 1), np.sqrt(ALIKE))
    to_m = robot_from_m[:, :3, :3].swapaxes(1, 2)
    moved = np.zeros((len(places), 6, 6))
    moved[:, :3, :3] = moved[:, 3:, 3:] = to_m
    moved[:, 3:, :3] = to_m @ cross_matrix(places - robot_from_m[:, :3, 3]) * (sds[0] / sds[3])
    of_any = np.hstack([alike, places / usual, robot_from_tcp[:, :3, :3].reshape(-1, 9) / np.sqrt(3)])
    scaled = np.zeros((len(places), 6, 1))
    away = np.einsum("nji,nj->ni", ots_from_m[:, :3, :3], ots_from_m[:, :3, 3])
    apart_mm = spread_mm(ots_from_m)
    scaled[:, 3:, 0] = -away / apart_mm
    late, delay = moving(robot_from_m, sds, frames)
    added = {
        Cause.ANY: _linear(moved, of_any / np.sqrt(3)),
        Cause.BENDING: _sagging(robot_from_m, places, sds),
        Cause.SCALE: scaled,
        Cause.DELAY: late,
    }
    return Fields(added, float(sds[3]) / apart_mm, delay)


def shows_scale(seen: FloatArray, ots_from_m: FloatArray, design: FloatArray, sd_mm: float) -> bool:
    """Tell whether a scale can show in poses ``seen`` (N, 4, 4) of places that err by ``sd_mm``, or noise alone.

    It shows in what the fit's constants, ``design`` (N, 6, p), leave of the places ``ots_from_m`` (N, 4, 4), as the
    robot tells them. Of a tool that swings about its tip that is the robot's noise, which is in the poses' errors,
    too, and then makes up for them with a scale of its own.
    """
    field = np.zeros((len(seen), 6))
    field[:, 3:] = np.einsum("nji,nj->ni", seen[:, :3, :3], ots_from_m[:, :3, 3]) / sd_mm
    flat = design.reshape(field.size, -1)
    left = field.ravel() - flat @ np.linalg.lstsq(flat, field.ravel(), rcond=None)[0]
    return bool(left @ left > LEAST_SHOWN**2 * field[:, 3:].size)


def spread_mm(poses: FloatArray) -> float:
    """Return how far apart the places of ``poses`` (N, 4, 4) are, RMS, or `LEAST_SPREAD` if that is less."""
    places = poses[:, :3, 3]
    apart, away = (np.sqrt((one**2).sum(axis=1).mean()) for one in (places - places.mean(axis=0), places))
    return float(max(apart, LEAST_SPREAD * away, np.finfo(float).tiny))


def _sagging(robot_from_m: FloatArray, places: FloatArray, sds: FloatArray) -> FloatArray:
    """Return (N, 6, 2): what a load at ``places`` (N, 3) that bends the arm by its lever adds, in ``sds`` (6,).

    That is a turn about the origin of R, in the upright plane of the place, and the shift outwards of one further up.
    """
    out = np.hypot(places[:, 0], places[:, 1])[:, None]
    outwards = places[:, :2] / np.maximum(out, np.finfo(float).tiny)
    usual = np.sqrt((places**2).sum(axis=1).mean())
    turned = np.zeros((len(places), 6, 2))
    turned[:, 0, 0], turned[:, 1, 0] = -outwards[:, 1], outwards[:, 0]
    turned[:, 3:5, 1] = outwards * usual
    lever = out / usual * max(sds[0], sds[3] / usual)
    return np.asarray(adjoint(invert(robot_from_m)) @ turned * lever[..., None] / sds[:, None])


def _linear(moved: FloatArray, numbers: FloatArray) -> FloatArray:
    """Return (N, 6, m k): what ``moved`` (N, 6, m) is for each of ``numbers`` (N, k)."""
    return np.asarray((moved[:, :, None, :] * numbers[:, None, :, None]).reshape(len(moved), 6, -1))
