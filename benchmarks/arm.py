"""Forward and inverse kinematics against Pinocchio, and solutions a second, on all cores.

    python -m benchmarks.arm [--arm kr6r900|ur5e|iiwa|panda|...-calibrated] [--poses N] [--seed S]

Of the iiwa the third joint is held at zero, of the Panda the last. The calibrated KR 6 and Panda have random errors of
up to 1e-3 rad and 0.3 mm in every joint's frame, the calibrated UR5e those that one left its factory with. Needs `pin`.
Solutions are counted over wall and over processor time: on a loaded machine only the latter tells much.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.compiled import all_postures
from ronnaplan.robot.arm.forward import forward
from ronnaplan.robot.arm.inverse import BRANCHES, inverse
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.arm.quality import singularity_deg
from ronnaplan.robot.arm.urdf import read_urdf
from ronnaplan.robot.arm.wrist import wrist_of
from tests.robot.arm.arms import UR5E_M, calibrated, calibrated_ur5e, iiwa, panda, ur

REPEATS = 10
FOUND_RAD = 1e-6
"""Angles that a pose was made of are told where those of an answer are nearer than this."""
BEYOND_DEG = (1, 2, 5, 8)
"""Those that are not told are counted beyond so many degrees from a singular posture."""


def described(text: str) -> SerialArm:
    """Return the arm of a URDF's ``text``."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "arm.urdf")
        path.write_text(text)
        return read_urdf(path).arm


ARMS: dict[str, Callable[[], SerialArm]] = {
    "kr6r900": kr6_r900,
    "ur5e": lambda: described(ur(UR5E_M)),
    "iiwa": lambda: described(iiwa()).holding("joint_a3", 0.0),
    "panda": lambda: described(panda()).holding("panda_joint7", 0.0),
    "kr6r900-calibrated": lambda: calibrated(kr6_r900(), 1),
    "ur5e-calibrated": lambda: described(calibrated_ur5e()),
    "panda-calibrated": lambda: calibrated(ARMS["panda"](), 1),
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arm", choices=ARMS, default="kr6r900")
    parser.add_argument("--poses", type=int, default=100_000, help="random poses")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    arm = ARMS[arguments.arm]()
    least, greatest = arm.limits_rad.T
    angles = np.random.default_rng(arguments.seed).uniform(least, greatest, (arguments.poses, 6))
    poses = forward(arm, angles)
    print(
        f"forward: largest difference from Pinocchio {np.abs(poses - peer(arm, angles)).max():.1e} (rotation, mm)"
    )
    found = inverse(arm, poses).angles_rad
    there = np.isfinite(found[..., 0])
    back = peer(arm, found[there])
    missed = np.abs(back - np.repeat(poses[:, None], BRANCHES, axis=1)[there]).max()
    print(
        f"inverse: {there.sum()} solutions of {len(poses)} poses, farthest from the pose by Pinocchio {missed:.1e}"
    )
    away = np.abs((found - angles[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)
    away = np.nan_to_num(away, nan=np.inf).min(axis=1)
    told, near = away < FOUND_RAD, singularity_deg(arm, angles)
    print(f"         the angles a pose was made of are told within {away[told].max():.1e} rad")
    print(
        f"         but {(~told).sum()} of {len(poses)}, "
        + ", ".join(f"{(~told & (near > deg)).sum()} beyond {deg}" for deg in BEYOND_DEG)
        + " degrees from a singular posture"
    )
    speed(arm, poses, int(there.sum()))


def peer(arm: SerialArm, angles: FloatArray) -> FloatArray:
    """Return Pinocchio's flange (M, 4, 4) in mm, of a model that is put together joint by joint."""
    import pinocchio as pin

    model, before = pin.Model(), 0
    for name, origin, axis in zip(arm.joints, arm.origins, arm.axes, strict=True):
        joint = pin.JointModelRevoluteUnaligned(axis)
        before = model.addJoint(before, joint, pin.SE3(origin[:3, :3], origin[:3, 3] / 1000.0), name)
    model.addFrame(
        pin.Frame("flange", before, pin.SE3(arm.flange[:3, :3], arm.flange[:3, 3] / 1000.0), pin.OP_FRAME)
    )
    data, flange = model.createData(), model.getFrameId("flange")
    found = np.empty((len(angles), 4, 4))
    for n, one in enumerate(angles):
        pin.framesForwardKinematics(model, data, one)
        found[n] = data.oMf[flange].homogeneous
    found[:, :3, 3] *= 1000.0
    return found


def speed(arm: SerialArm, poses: FloatArray, solutions: int) -> None:
    """Print how many solutions are found a second by as many threads as there are cores."""
    wrist, cores = wrist_of(arm), os.cpu_count() or 1
    parts = np.array_split(np.ascontiguousarray(poses), cores)
    rooms = [(np.empty((len(part), BRANCHES, 6)), np.empty(len(part))) for part in parts]

    def work(n: int) -> None:
        all_postures(wrist, parts[n], *rooms[n])

    work(0)
    wall, processor = time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(cores) as pool:
        for _ in range(REPEATS):
            list(pool.map(work, range(cores)))
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    total = REPEATS * solutions
    print(f"speed:   {total / wall / 1e6:.1f} million solutions a second on {cores} cores (wall)")
    print(f"         {total / processor / 1e6:.1f} million a second of one core's processor time")


if __name__ == "__main__":
    main()
