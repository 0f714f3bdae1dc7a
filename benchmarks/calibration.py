"""Tool calibrations: whether their error is as large as they state, whatever the memory of the noise.

    python -m benchmarks.calibration pivot|hand-eye [--poses N ...] [--recordings N] [--seed N]
    python -m benchmarks.calibration recording --from POSES

The tables give the mean normalized squared error, error' covariance^-1 error per degree of freedom: 1 is right, more
claims too much. POSES is any recording that `ronnaplan.tracking` reads; plain least squares is the peer there.
"""

from __future__ import annotations

import argparse
import itertools
import math
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan.geometry import FloatArray, unit
from ronnaplan.pose import Pose
from ronnaplan.report.tables import align
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from ronnaplan.robot.pivot import calibrate_pivot
from ronnaplan.tracking import read_recording
from ronnaplan.transforms import invert, rigid

PIVOT_MM = np.array([-800.0, -85, -2100])
ORIENTATION_DEG = 0.06
PLACE_MM = 0.25
"""A tracker's errors, standard deviations per axis."""
FILTER_POSES = 5
"""Memory of each of the two low passes that make noise smooth."""
TOOL_MM = (100.0, 400.0)
"""Lengths of the tools that are pivoted."""
NOISES = ("white", "AR(1) 0.5", "AR(1) 0.9", "AR(1) 0.97", "filtered", "random walk", "steady drift")


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
    """Mean normalized squared error of pivot or hand-eye calibrations, and its standard error."""
    measure = {"pivot": pivot_error, "hand-eye": hand_eye_errors}[kind]
    said = {"pivot": "of the tip", "hand-eye": "of M from TCP, of R from OTS"}[kind]
    rows = [[kind, *(f"{count} poses" for count in counts), ""]]
    for name, in_tool in itertools.product(NOISES, (False, True)):
        row = [f"{name}, {'tool' if in_tool else 'tracker'}'s axes"]
        for count in counts:
            streams = [np.random.default_rng([seed, i, count, in_tool, *name.encode()]) for i in range(recordings)]
            squares = np.array([measure(rng, count, name, in_tool) for rng in streams])
            spread = squares.std(axis=0, ddof=1) / np.sqrt(recordings)
            row.append(", ".join(f"{m:.2f} ({s:.2f})" for m, s in zip(squares.mean(axis=0), spread, strict=True)))
        rows.append([*row, ""])
        print(rows[-1], flush=True)
    return f"{align(rows)}\n({said}; {recordings} recordings a cell, standard errors in brackets)"


def tracker_errors(rng: np.random.Generator, count: int, name: str) -> FloatArray:
    """Return errors (count, 6), rotation vectors in rad and places in mm, of one of the `NOISES`.

    Each is of unit variance times `ORIENTATION_DEG` and `PLACE_MM`; a walk starts at zero and a drift passes zero in
    the middle, so that what is true of a pose is that without its errors; both go two standard deviations far.
    """
    from scipy.signal import lfilter  # takes a second

    white = rng.normal(size=(count, 6))
    found = white
    if name == "random walk":
        found = 0.3 * white + np.cumsum(rng.normal(size=white.shape), axis=0) * 2 / np.sqrt(count)
    elif name == "steady drift":
        found = white + 2 * np.linspace(-1, 1, count)[:, None] * rng.normal(size=6)
    elif name.startswith("AR(1)"):
        memory = float(name.split()[1])
        before = rng.normal(size=(int(20 / (1 - memory)), 6))
        found = lfilter([np.sqrt(1 - memory**2)], [1, -memory], np.concatenate([before, white]), axis=0)[-count:]
    elif name == "filtered":
        memory = math.exp(-1 / FILTER_POSES)
        rough = np.concatenate([rng.normal(size=(20 * FILTER_POSES, 6)), white])
        gain = np.sqrt((1 - memory**2) ** 3 / (1 + memory**2))  # leaves unit variance
        found = gain * lfilter([1], [1, -2 * memory, memory**2], rough, axis=0)[-count:]
    errors: FloatArray = found * np.repeat([np.radians(ORIENTATION_DEG), PLACE_MM], 3)
    return errors


def seen_with(poses: FloatArray, errors: FloatArray, in_tool: bool) -> FloatArray:
    """Return ``poses`` (N, 4, 4) with ``errors`` (N, 6), about the tool's origin, in its axes or the tracker's."""
    turns, rotations = Rotation.from_rotvec(errors[:, :3]).as_matrix(), poses[:, :3, :3]
    shifts = np.einsum("nij,nj->ni", rotations, errors[:, 3:]) if in_tool else errors[:, 3:]
    return rigid(rotations @ turns if in_tool else turns @ rotations, poses[:, :3, 3] + shifts)


def swing(rng: np.random.Generator, count: int) -> FloatArray:
    """Return the rotations (count, 3, 3) of a tool swung by up to 40 degrees about all axes."""
    t = np.linspace(0, 12 * np.pi, count) + rng.uniform(0, 7)
    turns = np.column_stack([np.sin(t), 0.6 * np.sin(0.4 * t + 1), np.cos(0.7 * t)])
    rotations: FloatArray = Rotation.from_rotvec(np.radians(40) * turns).as_matrix()
    return rotations


def pivot_error(rng: np.random.Generator, count: int, name: str, in_tool: bool) -> tuple[float]:
    """Return the normalized squared error of one pivot calibration's tip."""
    tip_mm = rng.uniform(*TOOL_MM) * unit(rng.normal(size=3))
    rotations = swing(rng, count)
    poses = rigid(rotations, PIVOT_MM - rotations @ tip_mm)
    found = calibrate_pivot(seen_with(poses, tracker_errors(rng, count, name), in_tool))
    error = found.tip_mm - tip_mm
    return (float(error @ np.linalg.solve(found.tip_covariance_mm2, error)) / 3,)


def hand_eye_errors(rng: np.random.Generator, count: int, name: str, in_tool: bool) -> tuple[float, float]:
    """Return the normalized squared errors of M from TCP and of R from OTS."""
    m_from_tcp, robot_from_ots = random_pose(rng, 100), random_pose(rng, 2000)
    t = np.linspace(0, 12 * np.pi, count)
    places_mm = 200 * np.column_stack([np.cos(0.6 * t), np.sin(0.8 * t), np.cos(0.35 * t + 1)])
    driven = rigid(swing(rng, count), places_mm)
    seen = invert(robot_from_ots) @ driven @ invert(m_from_tcp)
    found = calibrate_hand_eye(seen_with(seen, tracker_errors(rng, count, name), in_tool), driven)
    return normalized(found.m_from_tcp, m_from_tcp), normalized(found.robot_from_ots, robot_from_ots)


def normalized(found: Pose, truth: FloatArray) -> float:
    """Return the normalized squared error of a pose per degree of freedom."""
    off = truth @ invert(found.matrix)
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
