"""Looks again at one sphere: which show one, which contradict each other, and which would show one by other poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.errors import RefusedError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.misread import as_meant
from ronnaplan.robot.stereo.robot_markers import RobotMarkers

SAME_SPHERE_MM = 1.0
"""Two looks at one sphere put it no further apart."""
SAME_PLACE = 30.0
"""Nor, squared and in their errors, by more than these explain: errors as stated do so once in a million times."""
FAR_MM = 10.0
"""Spheres of looks that are farther apart come to one place by no chance where the poses are read in another way."""


def apart(spheres: RobotMarkers) -> tuple[FloatArray, FloatArray]:
    """Return how far (mm) any two looks put their spheres apart, and that in their errors, squared: (N, N) each.

    An error of the rig parts two looks that are turned.
    """
    places, own, jacobian = spheres.positions_mm, spheres.own_mm2, spheres.common_jacobian
    off = places[:, None] - places
    turned = jacobian[:, None] - jacobian
    errors = own[:, None] + own + turned @ spheres.tcp_from_rig.covariance @ turned.swapaxes(-1, -2)
    squared: FloatArray = np.einsum("nki,nkij,nkj->nk", off, np.linalg.inv(errors), off)
    return np.linalg.norm(off, axis=-1), squared


def same(away_mm: FloatArray, squared: FloatArray) -> NDArray[np.bool_]:
    """Return which looks (N, N) put a sphere at one place, within their errors."""
    return (away_mm <= SAME_SPHERE_MM) & (squared <= SAME_PLACE)


def contradiction(spheres: RobotMarkers) -> str | None:
    """Say which looks show one sphere, as no two lie so near to each other, where their errors do not explain it."""
    away_mm, squared = apart(spheres)
    pairs = np.argwhere(np.triu((away_mm <= SAME_SPHERE_MM) & (squared > SAME_PLACE), 1))
    if not len(pairs):
        return None
    one, other = max(pairs.tolist(), key=lambda pair: float(squared[tuple(pair)]))
    more = f" (and {len(pairs) - 1} more pairs of looks)" if len(pairs) > 1 else ""
    return (
        f"frames {spheres.labels[one]} and {spheres.labels[other]}{more} show one sphere at places "
        f"{away_mm[one, other]:.2f} mm apart, {np.sqrt(squared[one, other]):.0f} times their errors: head, base or "
        "cameras moved meanwhile, or the robot errs by more than is stated; fasten them and look again, or state "
        "its errors (--sigma-robot, --sigma-robot-deg)"
    )


def require_apart(spheres: RobotMarkers, diameter_mm: float) -> None:
    """Raise `RefusedError` where two spheres that are not one and the same overlap, or are one by other poses only.

    Of spheres that are far apart and would be one if the robot's poses were read otherwise, poses were misread. Where
    no sphere was looked at twice nothing tells it.
    """
    away_mm, squared = apart(spheres)
    otherwise = read_otherwise(spheres, same(away_mm, squared))
    if misread := one_if_misread(otherwise, away_mm > FAR_MM):
        one, other = misread.looks
        raise RefusedError(
            f"the spheres of frames {spheres.labels[one]} and {spheres.labels[other]} are "
            f"{away_mm[one, other]:.0f} mm apart, but one and the same if in the robot's poses {misread.mistakes}; "
            "turn them into matrices, or a quaternion, anew"
        )
    overlap = np.argwhere((away_mm > SAME_SPHERE_MM) & (away_mm < diameter_mm))
    if len(overlap):
        one, other = overlap[0]
        misread = one_if_misread(otherwise, away_mm > SAME_SPHERE_MM)
        hint = "" if misread is None else f", and whether in them {misread.mistakes}, which would make them one"
        raise RefusedError(
            f"the spheres of frames {spheres.labels[one]} and {spheres.labels[other]} are "
            f"{away_mm[one, other]:.1f} mm apart, yet {diameter_mm:g} mm wide; check that the robot's poses are those "
            f"of these looks{hint}"
        )


Otherwise = tuple[str, NDArray[np.bool_]]
"""A mistake in the robot's poses, a clause, and which looks (N, N) show one sphere without it."""


class Misread(NamedTuple):
    """With which mistakes in the robot's poses, a clause, two looks show one sphere."""

    mistakes: str
    looks: tuple[int, int]


def read_otherwise(spheres: RobotMarkers, shown: NDArray[np.bool_]) -> list[Otherwise]:
    """Return mistakes without which none of the looks that ``shown`` (N, N) has at one sphere are at two."""
    meant = (
        (mistake, same(*apart(spheres.taken_from(poses)))) for mistake, poses in as_meant(spheres.robot_from_tcp)
    )
    return [(mistake, one) for mistake, one in meant if (one | ~shown).all()]


def one_if_misread(otherwise: Sequence[Otherwise], parted: NDArray[np.bool_]) -> Misread | None:
    """Return what makes spheres one that are ``parted`` (N, N); None where nothing does."""
    found: dict[str, tuple[int, int]] = {}
    for mistake, meant in otherwise:
        looks = np.argwhere(np.triu(meant & parted, 1))
        if len(looks):
            found.setdefault(mistake, (int(looks[0, 0]), int(looks[0, 1])))
    return Misread(", or ".join(found), next(iter(found.values()))) if found else None
