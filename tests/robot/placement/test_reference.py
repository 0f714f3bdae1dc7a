"""The posture that is proposed for an arm: bent, before its shoulder and above it, and apart from itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.distance import cdist

from ronnaplan.documents.room_example import example_of, example_room
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import jacobian, link_frames
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.arm.quality import singularity_deg
from ronnaplan.robot.arm.urdf import read_urdf
from ronnaplan.robot.placement.reference import proposed_deg
from ronnaplan.transforms import transform_points
from tests.long import few_and_others
from tests.robot.arm import arms

LENGTH_MM = 300.0
PLACES = np.linspace(0.0, 1.0, 50)[:, None]


def read(text: str, tmp_path: Path) -> SerialArm:
    (tmp_path / "arm.urdf").write_text(text)
    return read_urdf(tmp_path / "arm.urdf").arm


ARMS: dict[str, Callable[[Path], SerialArm]] = {
    "built in": lambda _: kr6_r900(),
    "KR 6": lambda path: read(arms.KR6, path),
    "hanging": lambda path: read(arms.hanging(arms.KR6), path),
    "UR5e": lambda path: read(arms.ur(arms.UR5E_M), path),
    "UR10e": lambda path: read(arms.ur(arms.UR10E_M), path),
    "calibrated UR5e": lambda path: read(arms.calibrated_ur5e(), path),
    "iiwa, 3 held": lambda path: read(arms.iiwa(), path).holding("joint_a3", 0.0),
    "iiwa, 7 held": lambda path: read(arms.iiwa(), path).holding("joint_a7", 0.0),
    "Panda": lambda path: read(arms.panda(), path).holding("panda_joint7", np.pi / 4),
}


ALIKE = ("KR 6", "UR10e", "iiwa, 7 held")
"""Arms that differ from one of the others by their lengths, or by which joint is held."""


def least_apart_mm(arm: SerialArm, posture_rad: FloatArray) -> float:
    """Least distance of bodies, the room's tool among them, with three joints between them or more, by places."""
    frames = link_frames(arm, posture_rad)
    bodies = [
        (
            one.link,
            transform_points(frames[one.link], one.start_mm + PLACES * (one.end_mm - one.start_mm)),
            one.radius_mm,
        )
        for one in arm.bodies
    ]
    for one in example_room().tool.bodies:
        line = np.array(one.start_mm) + PLACES * (np.array(one.end_mm) - np.array(one.start_mm))
        bodies.append((len(arm), transform_points(frames[-1] @ arm.flange, line), one.radius_mm))
    pairs = [pair for pair in combinations(bodies, 2) if abs(pair[0][0] - pair[1][0]) >= 3]
    return float(min(cdist(a, b).min() - radius - other for (_, a, radius), (_, b, other) in pairs))


@few_and_others("name", [name for name in ARMS if name not in ALIKE], ALIKE)
def test_a_proposed_posture_is_bent_and_apart_from_all(name: str, tmp_path: Path) -> None:
    """Middles of limits are zeros for most arms: these stand stretched then, or meet themselves."""
    arm = ARMS[name](tmp_path)
    posture = proposed_deg(arm, example_room())
    assert [float(round(angle)) for angle in posture] == list(posture)
    angles = np.radians(posture)
    assert posture[0] == 0.0
    assert (np.minimum(angles - arm.limits_rad[:, 0], arm.limits_rad[:, 1] - angles) > np.radians(25.0)).all()
    assert singularity_deg(arm, angles) > 25.0
    moved = jacobian(arm, angles)  # by which no direction is nearly lost, whatever the closed form says
    moved[3:] /= LENGTH_MM
    assert np.linalg.svd(moved, compute_uv=False)[-1] > 0.05
    assert least_apart_mm(arm, angles) > 20.0
    frames = link_frames(arm, angles)
    axis, foot = frames[1, :3, :3] @ arm.axes[0], frames[1, :3, 3]
    flange = (frames[-1] @ arm.flange)[:3, 3] - frames[2, :3, 3]
    up = np.sign(axis @ foot) * (axis @ flange)  # away from where it is mounted
    reach = sum(np.linalg.norm(origin[:3, 3]) for origin in arm.origins[2:6])
    ahead = np.sqrt(flange @ flange - up * up)
    assert 0.25 * reach < ahead < 0.75 * reach
    assert 0.05 * reach < up


def test_an_arm_that_reaches_nothing_before_it_is_proposed_the_middles_of_its_limits() -> None:
    narrow = np.radians([[-170, 170], [-9, 5], [-5, 7], [-1, 5], [-5, 9], [-5, 5]])
    assert proposed_deg(replace(kr6_r900(), limits_rad=narrow), example_room()) == (0.0, -2.0, 1.0, 2.0, 2.0, 0.0)


def test_links_whose_shapes_are_meshes_are_taken_to_be_thin(tmp_path: Path) -> None:
    """Their radius is left to be measured; a posture in which they hardly meet as lines would be none."""
    arm = replace(read(arms.ur(arms.UR10E_M), tmp_path), bodies=())
    (line,) = (one for one in example_of(arm, arm, are_meshes=True).splitlines() if one.startswith("reference"))
    angles = np.radians([float(angle) for angle in line.split("[")[1].rstrip("]").split(",")])
    frames = link_frames(arm, angles)
    lines = [  # from joint to joint
        frames[n, :3, 3] + PLACES * (frames[n, :3, :3] @ end[:3, 3])
        for n, end in enumerate([*arm.origins, arm.flange])
    ]
    apart = min(cdist(a, b).min() for (n, a), (m, b) in combinations(enumerate(lines), 2) if m - n >= 3)
    assert apart > 20.0 + 2 * 0.05 * (612.7 + 571.6)
