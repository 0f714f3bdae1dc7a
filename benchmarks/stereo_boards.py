"""Cameras calibrated on boards here or there in their images: which balls are accepted, and how far off they are.

    python -m benchmarks.stereo_boards [--calibrations N] [--seed N] [--layouts NAME ...]

The cameras are those of `phantoms.robot_session`, calibrated on eight rendered boards; balls lie all over what both
see. Errors are those after the best rigid motion of the accepted, as which a calibration of the TCP takes what is
common to all. The normalized error is error' covariance^-1 error / 3, 1 being right.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from phantoms.cameras import board_image, project, sphere_image
from phantoms.robot_session import CAMERAS, CORNERS, DIAMETER_MM, DISTORTIONS, MATRICES, SIZE
from ronnaplan.errors import RonnaplanError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import Pose
from ronnaplan.report.tables import align
from ronnaplan.robot.chain import TCP
from ronnaplan.robot.stereo.calibration import calibrate_on_board
from ronnaplan.robot.stereo.camera import RIG
from ronnaplan.robot.stereo.sphere import StereoSphere, locate_sphere
from ronnaplan.sigmas import LARGEST_STATED_MM
from ronnaplan.transforms import invert, rigid, transform_points

REPORTED = 9300
"""Seeds from here on are reported; those from 9100 on were looked at while tuning."""
BOARDS, BALLS, TILT_DEG, AWAY_MM, DEEP_MM = 8, 18, 28.0, 300.0, 15.0
ACCURATE_MM, FEWEST_ALIGNED = 0.02, 4
BORDER_PX = 3.0
LAYOUTS = {
    "all over": (6.0, (-150, 150), (-125, 125)),
    "small, all over": (3.0, (-240, 240), (-180, 180)),
    "in the middle": (5.5, (-20, 20), (-15, 15)),
    "small, in the middle": (3.5, (-30, 30), (-25, 25)),
    "on the right": (5.0, (60, 170), (-110, 110)),
    "on the left": (5.0, (-170, -60), (-110, 110)),
    "above": (5.0, (-160, 160), (-150, -60)),
    "small, in a corner": (3.5, (90, 220), (60, 175)),
}
"""Side of the squares (mm), and where the boards' middles are, columns and rows from the left image's middle."""


@dataclass
class Score:
    """What became of the balls of one layout."""

    balls: int = 0
    errors_mm: list[float] = field(default_factory=list)
    normalized: list[float] = field(default_factory=list)
    refused_mm: list[float] = field(default_factory=list)
    """How far off balls would have been that were found, but refused."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calibrations", type=int, default=3)
    parser.add_argument("--seed", type=int, default=REPORTED)
    parser.add_argument("--layouts", nargs="*", metavar="NAME", help="only those whose name holds one of these")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rows = [
        ["boards", "balls", "accepted", "worst mm", "off", "normalized error", "refused", "worst mm", "accurate"]
    ]
    for name in LAYOUTS:
        if arguments.layouts and not any(part in name for part in arguments.layouts):
            continue
        score = Score()
        for seed in range(arguments.seed, arguments.seed + arguments.calibrations):
            measure(name, np.random.default_rng([seed, list(LAYOUTS).index(name)]), score)
        rows.append(row_of(name, score))
        print(rows[-1], flush=True)
    print(align(rows))


def measure(
    layout: str, rng: np.random.Generator, score: Score, *, boards: int = BOARDS, balls: int = BALLS
) -> None:
    """Calibrate on ``boards`` of one ``layout`` and add what becomes of ``balls`` to the ``score``."""
    pairs = [_board(layout, rng) for _ in range(boards)]
    lefts, rights = [left for left, _ in pairs], [right for _, right in pairs]
    found = calibrate_on_board(lefts, rights, corners=CORNERS, square_mm=LAYOUTS[layout][0])
    rig = found.rig(Pose.exact(np.eye(4), TCP, RIG))
    score.balls += balls
    true, spheres = [], []
    for _ in range(balls):
        center, left, right = _ball(rng)
        try:
            spheres.append(locate_sphere(left, right, rig, diameter_mm=DIAMETER_MM, largest_mm=np.inf))
        except RonnaplanError:  # of a lens that is told wrongly where the ball is, no outline is a sphere's
            continue
        true.append(center)
    count(np.array(true), spheres, np.array([is_known(one) for one in spheres]), score)


def is_known(sphere: StereoSphere) -> bool:
    """Tell whether a sphere is known so well that it is accepted."""
    return float(np.trace(sphere.covariance_mm2)) <= LARGEST_STATED_MM**2


def count(true: FloatArray, spheres: list[StereoSphere], accepted: FloatArray, score: Score) -> None:
    """Add what ``spheres`` are off the ``true`` centers (N, 3) once those that are ``accepted`` (N) are aligned."""
    if accepted.sum() < FEWEST_ALIGNED:
        return
    seen = np.array([one.position_mm for one in spheres])
    a, b = true[accepted].mean(axis=0), seen[accepted].mean(axis=0)
    turn = Rotation.align_vectors(true[accepted] - a, seen[accepted] - b)[0]
    errors = turn.apply(seen - b) + a - true
    for error, sphere, kept in zip(errors, spheres, accepted, strict=True):
        (score.errors_mm if kept else score.refused_mm).append(float(np.linalg.norm(error)))
        if kept:
            score.normalized.append(float(error @ np.linalg.solve(sphere.covariance_mm2, error)) / 3)


def row_of(name: str, score: Score) -> list[str]:
    """Return a layout's row of the table."""
    off = sum(error > ACCURATE_MM for error in score.errors_mm)
    accurate = sum(error <= ACCURATE_MM for error in score.refused_mm)
    return [
        name,
        str(score.balls),
        str(len(score.errors_mm)),
        f"{max(score.errors_mm, default=0.0):.4f}",
        str(off),
        f"{np.mean(score.normalized):.2f}" if score.normalized else "",
        str(score.balls - len(score.errors_mm)),
        f"{max(score.refused_mm, default=0.0):.4f}",
        str(accurate),
    ]


def _board(layout: str, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return both images of a board that is whole in both, tilted at random."""
    square_mm, across, down = LAYOUTS[layout]
    grid = np.zeros((CORNERS[0] * CORNERS[1], 3))
    grid[:, :2] = np.mgrid[: CORNERS[0], : CORNERS[1]].T.reshape(-1, 2) * square_mm
    between = Rotation.from_euler("y", -14.5, degrees=True)
    while True:
        turn = between * Rotation.from_euler("xyz", rng.uniform(-1, 1, 3) * TILT_DEG, degrees=True)
        away = AWAY_MM + rng.uniform(-1, 1) * DEEP_MM
        middle = np.array([rng.uniform(*across), rng.uniform(*down), MATRICES[0][0, 0]]) * away / MATRICES[0][0, 0]
        board = rigid(turn.as_matrix(), middle - turn.apply(grid.mean(axis=0)))
        if all(_is_within(_shown(transform_points(board, grid), side)) for side in range(2)):
            break
    left, right = (
        board_image(invert(place) @ board, CORNERS, square_mm, matrix, distortion, rng, SIZE)
        for place, matrix, distortion in zip(CAMERAS, MATRICES, DISTORTIONS, strict=True)
    )
    return left, right


def _ball(rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the center (3,) of a ball that is whole in both images, and these."""
    while True:
        center = rng.uniform((-60.0, -45.0, AWAY_MM - 10), (60.0, 45.0, AWAY_MM + 10))
        outline = center + np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]) * DIAMETER_MM * 0.6
        if all(_is_within(_shown(outline, side)) for side in range(2)):
            break
    left, right = (
        sphere_image(
            [transform_points(invert(place), center[None])[0]], DIAMETER_MM, matrix, distortion, rng, size=SIZE
        )
        for place, matrix, distortion in zip(CAMERAS, MATRICES, DISTORTIONS, strict=True)
    )
    return center, left, right


def _shown(points_mm: FloatArray, side: int) -> FloatArray:
    return project(transform_points(invert(CAMERAS[side]), points_mm), MATRICES[side], DISTORTIONS[side])


def _is_within(pixels: FloatArray) -> bool:
    return bool(((pixels > BORDER_PX) & (pixels < np.array(SIZE[::-1]) - 1 - BORDER_PX)).all())


if __name__ == "__main__":
    main()
