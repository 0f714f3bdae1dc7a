"""Tool calibrations: whether their error is as large as they state, whatever the memory of the noise.

    python -m benchmarks.calibration pivot|hand-eye [--poses N ...] [--recordings N] [--seed N]
    python -m benchmarks.calibration recording --from POSES

The tables give the mean normalized squared error, error' covariance^-1 error per degree of freedom: 1 is right, more
claims too much. POSES is any recording that `ronnaplan.tracking` reads; plain least squares is the peer there.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from ronnaplan.geometry import FloatArray
from ronnaplan.pose import invert
from ronnaplan.report.tables import align
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from ronnaplan.robot.pivot import calibrate_pivot
from ronnaplan.tracking import read_recording

TIP_MM = np.array([-15.0, 240, -7])
NOISES: dict[str, tuple[float | str, bool]] = {
    "white": ("white", False),
    "AR(1) 0.5": (0.5, False),
    "AR(1) 0.9": (0.9, False),
    "AR(1) 0.9, tool's axes": (0.9, True),
    "AR(1) 0.97": (0.97, False),
    "random walk": ("walk", False),
    "steady drift": ("drift", False),
}


BLOCK = 4
"""Recordings of one stream of random numbers, so that a table may grow."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("pivot", "hand-eye", "recording"))
    parser.add_argument("--poses", type=int, nargs="+", default=[100, 300, 1000, 3000])
    parser.add_argument("--recordings", type=int, default=60, help="simulated recordings a cell")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--from", type=Path, metavar="POSES", dest="path")
    arguments = parser.parse_args()
    if arguments.what == "recording":
        print(pivot_table(arguments.path))
    else:
        print(honesty_table(arguments.what, arguments.poses, arguments.recordings, arguments.seed))


def honesty_table(kind: str, counts: list[int], recordings: int, seed: int) -> str:
    """Mean normalized squared error of pivot or hand-eye calibrations."""
    measure = {"pivot": pivot_error, "hand-eye": hand_eye_error}[kind]
    rows = [[kind, *(f"{count} poses" for count in counts), ""]]
    for name, (memory, in_tool) in NOISES.items():
        means = []
        for count in counts:
            streams = [
                np.random.default_rng([seed, block, count, sum(map(ord, name))])
                for block in range(recordings // BLOCK)
            ]
            means.append(np.mean([measure(rng, count, memory, in_tool) for rng in streams for _ in range(BLOCK)]))
        rows.append([name, *(f"{mean:.2f}" for mean in means), ""])
        print(rows[-1], flush=True)
    return f"{align(rows)}\n({recordings // BLOCK * BLOCK} recordings a cell)"


def noise(rng: np.random.Generator, shape: tuple[int, int], memory: float | str) -> FloatArray:
    """Return noise of unit variance, the first axis being time; a walk or drift spans two units more."""
    count = shape[0]
    white = rng.normal(size=shape)
    if memory == "walk":
        found: FloatArray = 0.3 * white + np.cumsum(rng.normal(size=shape), axis=0) * 2 / np.sqrt(count)
        return found
    if memory == "drift":
        return white + 2 * np.linspace(-1, 1, count)[:, None] * rng.normal(size=shape[1])
    if memory == "white":
        return white
    before = rng.normal(size=(int(20 / (1 - float(memory))), shape[1]))
    joined = np.concatenate([before, white]) * np.sqrt(1 - float(memory) ** 2)
    filtered: FloatArray = lfilter([1], [1, -float(memory)], joined, axis=0)[-count:]
    return filtered


def swing(rng: np.random.Generator, count: int) -> FloatArray:
    """Return the rotations (count, 3, 3) of a tool swung by up to 40 degrees about all axes."""
    t = np.linspace(0, 12 * np.pi, count) + rng.uniform(0, 7)
    turns = np.column_stack([np.sin(t), 0.6 * np.sin(0.4 * t + 1), np.cos(0.7 * t)])
    rotations: FloatArray = Rotation.from_rotvec(np.radians(40) * turns).as_matrix()
    return rotations


def pivot_error(rng: np.random.Generator, count: int, memory: float | str, in_tool: bool) -> float:
    """Return the normalized squared error of one pivot calibration with noise of 0.3 mm an axis."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = swing(rng, count)
    errors = 0.3 * noise(rng, (count, 3), memory)
    errors = np.einsum("nij,nj->ni", poses[:, :3, :3], errors) if in_tool else errors
    poses[:, :3, 3] = np.array([-800.0, -85, -2100]) - poses[:, :3, :3] @ TIP_MM + errors
    found = calibrate_pivot(poses)
    error = found.tip_mm - TIP_MM
    return float(error @ np.linalg.solve(found.tip_covariance_mm2, error)) / 3


def hand_eye_error(rng: np.random.Generator, count: int, memory: float | str, in_tool: bool) -> float:
    """Return the normalized squared error of M from TCP, for 0.06 degrees and 0.2 mm an axis."""
    m_from_tcp, robot_from_ots = random_pose(rng, 100), random_pose(rng, 2000)
    driven = np.tile(np.eye(4), (count, 1, 1))
    driven[:, :3, :3] = swing(rng, count)
    t = np.linspace(0, 12 * np.pi, count)
    driven[:, :3, 3] = 200 * np.column_stack([np.cos(0.6 * t), np.sin(0.8 * t), np.cos(0.35 * t + 1)])
    seen = invert(robot_from_ots) @ driven @ invert(m_from_tcp)
    errors = noise(rng, (count, 6), memory)
    turns, shifts = Rotation.from_rotvec(1e-3 * errors[:, :3]).as_matrix(), 0.2 * errors[:, 3:]
    rotations = seen[:, :3, :3].copy()
    seen[:, :3, 3] += np.einsum("nij,nj->ni", rotations, shifts) if in_tool else shifts
    seen[:, :3, :3] = rotations @ turns if in_tool else turns @ rotations
    found = calibrate_hand_eye(seen, driven).m_from_tcp
    off = m_from_tcp @ invert(found.matrix)
    error = np.concatenate([Rotation.from_matrix(off[:3, :3]).as_rotvec(), off[:3, 3]])
    return float(error @ np.linalg.solve(found.covariance, error)) / 6


def random_pose(rng: np.random.Generator, reach_mm: float) -> FloatArray:
    """Return any pose (4, 4) within some ``reach_mm``."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(rng=rng).as_matrix(), reach_mm * rng.normal(size=3)
    return pose


def pivot_table(path: Path) -> str:
    """Pivot calibration of a recorded tool, slips included, and how its parts agree: chi-square on 3, expected 3."""
    poses = read_recording(path).poses("tool")
    own = calibrate_pivot(poses)
    design = np.concatenate([poses[:, :3, :3], np.tile(-np.eye(3), (len(poses), 1, 1))], axis=2).reshape(-1, 6)
    plain = np.linalg.lstsq(design, -poses[:, :3, 3].ravel(), rcond=None)[0]
    plain_rms = np.sqrt(((design @ plain + poses[:, :3, 3].ravel()) ** 2).sum() / len(poses))
    rows = [["", "x", "y", "z", "RMS kept, mm", ""]]
    rows.append(["least squares, all poses", *numbers(plain[:3]), f"{plain_rms:.2f}", ""])
    rows.append([f"ronnaplan ({own.slipped.sum()} poses left out)", *numbers(own.tip_mm), f"{own.rms_mm:.2f}", ""])
    rows.append(["  its standard error", *numbers(np.sqrt(np.diag(own.tip_covariance_mm2))), "", ""])
    for count in (2, 3, 4):
        parts = [calibrate_pivot(part) for part in np.array_split(poses, count)]
        for i, (one, other) in enumerate(itertools.pairwise(parts)):
            apart = one.tip_mm - other.tip_mm
            square = apart @ np.linalg.solve(one.tip_covariance_mm2 + other.tip_covariance_mm2, apart)
            rows.append([f"  part {i + 1} against {i + 2} of {count}", *numbers(apart), f"chi2 {square:.1f}", ""])
    slips = ", ".join(f"{first}-{last}" for first, last in own.slips)
    return f"{align(rows)}\nslipped poses: {slips}"


def numbers(values: FloatArray) -> list[str]:
    """Format mm."""
    return [f"{value:.2f}" for value in values]


if __name__ == "__main__":
    main()
