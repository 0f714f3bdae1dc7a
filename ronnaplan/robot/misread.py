"""How the rotations of poses are misread when they are turned into matrices, and the poses as they would be right."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.transforms import invert

OTHER_ORDER = "angles about X, Y and Z are taken for such about Z, Y and X, or the other way round"
OTHER_AXES = "axes that turn along are taken for fixed ones, or the other way round"
NO_ANGLES = "rotation vectors were read as angles about X, Y and Z"


def as_meant(poses: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield mistakes, each as a clause, and what ``poses`` (N, 4, 4) that were read with it would be without.

    Angles are Tait-Bryan ones, of which the second is within a quarter turn. What confuses two ways to read them comes
    twice, as either may be meant.
    """
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(poses[:, :3, :3])
    numbers = turns.as_quat()
    about_zyx = _about_zyx(turns.as_matrix())
    about_xyz = -_about_zyx(turns.inv().as_matrix())[:, ::-1]
    yield "each is inverted", invert(poses)
    for mistake, right in (
        ("the rotations are transposed", turns.inv()),
        (
            "the scalar is the quaternions' first number, not the last",
            Rotation.from_quat(np.roll(numbers, -1, axis=1)),
        ),
        (
            "the scalar is the quaternions' last number, not the first",
            Rotation.from_quat(np.roll(numbers, 1, axis=1)),
        ),
        ("the angles about Z and X are exchanged", Rotation.from_euler("ZYX", about_zyx[:, ::-1])),
        (OTHER_ORDER, Rotation.from_euler("ZYX", about_xyz)),
        (OTHER_ORDER, Rotation.from_euler("XYZ", about_zyx)),
        (OTHER_AXES, Rotation.from_euler("ZYX", about_xyz[:, ::-1])),
        (OTHER_AXES, Rotation.from_euler("XYZ", about_zyx[:, ::-1])),
        (NO_ANGLES, Rotation.from_rotvec(about_zyx[:, ::-1])),
        (NO_ANGLES, Rotation.from_rotvec(about_xyz)),
    ):
        meant = poses.copy()
        meant[:, :3, :3] = right.as_matrix()
        yield mistake, meant


def misread_as(poses: FloatArray, agree: Callable[[FloatArray], bool]) -> str | None:
    """Say with which mistakes ``poses`` (N, 4, 4), which do not, would ``agree``, if any."""
    mistakes = [mistake for mistake, meant in as_meant(poses) if agree(meant)]
    return ", or ".join(dict.fromkeys(mistakes)) or None


def mistake_in(
    tracker: FloatArray, robot: FloatArray, agree: Callable[[FloatArray, FloatArray], bool]
) -> str | None:
    """Say with which mistake poses (N, 4, 4) of ``tracker`` and ``robot``, which do not, would ``agree``, if any.

    Several may explain it, as where the TCP hardly left its place: all are told.
    """
    found: dict[str, list[str]] = {}
    for (mistake, of_tracker), (_, of_robot) in zip(as_meant(tracker), as_meant(robot), strict=True):
        for whose, poses in (
            ("the tracker's poses", (of_tracker, robot)),
            ("the robot's poses", (tracker, of_robot)),
            ("the poses of both", (of_tracker, of_robot)),
        ):
            if agree(*poses) and whose not in found.setdefault(mistake, []):
                found[mistake].append(whose)
    return ", or ".join(f"in {' or '.join(whose)} {mistake}" for mistake, whose in found.items() if whose) or None


def _about_zyx(rotations: FloatArray) -> FloatArray:
    """Return the angles (N, 3) of turns about Z, then the new Y, then the newest X."""
    x, y, z = np.moveaxis(rotations, 1, 0)
    level = np.hypot(x[:, 0], y[:, 0])
    return np.column_stack(
        [np.arctan2(y[:, 0], x[:, 0]), np.arctan2(-z[:, 0], level), np.arctan2(z[:, 1], z[:, 2])]
    )
