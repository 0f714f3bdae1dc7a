"""The recordings of one robot's session about a phantom's head: what tracker, robot and cameras would have written.

``python -m phantoms.robot_session CASE OUT`` reads the truth of a phantom and of its tracker's readings in CASE and
writes to the new folder OUT: poses about a divot, poses of tracker and robot together, the tool at rest, images of a
board, of a resting sphere and of each marker, and ``truth.json``.
"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, ArgumentTypeError
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from phantoms.cameras import board_image, sphere_image
from phantoms.solids import FloatArray, Vector

READINGS_TRUTH = "readings_truth.json"
SIZE = (512, 640)
CORNERS, SQUARE_MM, DIAMETER_MM = (9, 7), 6.0, 11.5
MATRICES = (
    np.array([[2100.0, 0, 322], [0, 2098, 250], [0, 0, 1]]),
    np.array([[2115.0, 0, 315], [0, 2118, 260], [0, 0, 1]]),
)
DISTORTIONS = (np.array([-0.12, 0.2, 8e-4, -5e-4, 0.05]), np.array([-0.15, 0.1, -6e-4, 7e-4, 0]))
M_SPHERES_MM = np.array([[0.0, 60, 0], [45, 0, 0], [0, -75, 0], [-90, 0, 0]])
"""The spheres on the robot's tool, in its frame M."""
SUPINE = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
"""A room from CT: the patient on the back, the crown towards -x."""
HEAD_MM, TURN_DEG = np.array([1045.0, -25, 250]), 8.0
"""The middle of the head's markers in R, and the turn of the robot at the crown: near what `robot place` finds."""
PIVOT_POSES, HAND_EYE_POSES, REST_FRAMES, BOARDS, LOOKS = 150, 40, 20, 7, 9
SESSION_SEED = 7
"""Draws the session that is written; another one has other poses."""
READING_SD_MM, ROBOT_SD_MM, ROBOT_SD_DEG = 0.1, 0.03, 0.01


def placed(rotation: Rotation, place_mm: Vector) -> FloatArray:
    """Return the pose (4, 4) of a rotation and a place (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), place_mm
    return matrix


CAMERAS = np.eye(4), placed(Rotation.from_euler("y", -29.0, degrees=True), (155.0, 0, 0))
"""The rig from its left and its right camera."""


@dataclass
class Session:
    """The true poses (4, 4) of a session, and the noise."""

    ots_from_ct: FloatArray
    markers_ots_mm: FloatArray
    """The markers (N, 3) as they are at the session."""
    labels: tuple[str, ...]
    rng: np.random.Generator
    robot_from_ots: FloatArray = field(init=False)
    m_from_tcp: FloatArray = field(
        default_factory=lambda: placed(Rotation.from_euler("zyx", (40, 25, -70), degrees=True), (-15.0, 30, 180))
    )
    tcp_from_rig: FloatArray = field(
        default_factory=lambda: placed(Rotation.from_euler("yx", (14.5, 3), degrees=True), (-78.0, 4, -290))
    )

    def __post_init__(self) -> None:
        head = self.markers_ots_mm.mean(axis=0)
        ct_from_ots = Rotation.from_matrix(self.ots_from_ct[:3, :3]).inv()
        turn = Rotation.from_euler("z", -TURN_DEG, degrees=True) * Rotation.from_matrix(SUPINE) * ct_from_ots
        self.robot_from_ots = placed(turn, HEAD_MM - turn.apply(head))

    @classmethod
    def of_case(cls, case: Path, seed: int) -> Session:
        """Return the session about the phantom in ``case``."""
        readings = json.loads((case / READINGS_TRUTH).read_text(encoding="utf-8"))
        return cls(
            np.array(readings["ots_from_ct"]),
            np.array([one["center"] for one in readings["markers"]]),
            tuple(one["label"] for one in readings["markers"]),
            np.random.default_rng(seed),
        )

    @property
    def head_mm(self) -> FloatArray:
        """The head's markers (N, 3) in R."""
        turned: FloatArray = self.markers_ots_mm @ self.robot_from_ots[:3, :3].T
        return turned + self.robot_from_ots[:3, 3]

    @property
    def beside_mm(self) -> FloatArray:
        """Where the arm stands beside the head (3,) in R."""
        beside: FloatArray = self.head_mm.mean(axis=0) + np.array([0, 250.0, -100])
        return beside

    def told(self, robot_from_tcp: FloatArray) -> FloatArray:
        """Return what the robot says of its pose: with its error, about the TCP."""
        turn = Rotation.from_rotvec(self.rng.normal(0, np.radians(ROBOT_SD_DEG), 3))
        off = placed(turn * Rotation.from_matrix(robot_from_tcp[:3, :3]), robot_from_tcp[:3, 3])
        off[:3, 3] += self.rng.normal(0, ROBOT_SD_MM, 3)
        return off

    def tracked(self, robot_from_tcp: FloatArray) -> FloatArray:
        """Return what the tracker says of M: the pose that fits its noisy readings of the spheres."""
        true = np.linalg.inv(self.robot_from_ots) @ robot_from_tcp @ np.linalg.inv(self.m_from_tcp)
        seen = M_SPHERES_MM @ true[:3, :3].T + true[:3, 3]
        seen += self.rng.normal(0, READING_SD_MM, seen.shape)
        a, b = M_SPHERES_MM.mean(axis=0), seen.mean(axis=0)
        turn, _ = Rotation.align_vectors(seen - b, M_SPHERES_MM - a)
        return placed(turn, b - turn.apply(a))

    def about(self, place_mm: FloatArray, tilt_deg: float, aside_mm: float = 0.0) -> FloatArray:
        """Return R from TCP with the TCP near a place of R, tilted at random from looking down."""
        tilt = Rotation.from_euler("xyz", self.rng.uniform(-tilt_deg, tilt_deg, 3), degrees=True)
        return placed(
            tilt * Rotation.from_euler("x", 180, degrees=True), place_mm + self.rng.uniform(-1, 1, 3) * aside_mm
        )

    def look(self, robot_from_tcp: FloatArray, sphere_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the left and the right image of a sphere of R."""
        images = []
        for place, matrix, distortion in zip(CAMERAS, MATRICES, DISTORTIONS, strict=True):
            camera = np.linalg.inv(robot_from_tcp @ self.tcp_from_rig @ place)
            center = camera[:3, :3] @ sphere_mm + camera[:3, 3]
            images.append(sphere_image([center], DIAMETER_MM, matrix, distortion, self.rng, size=SIZE))
        return images[0], images[1]

    def board(self) -> tuple[FloatArray, FloatArray]:
        """Return the left and the right image of the board, held up before the cameras."""
        middle = np.array([(CORNERS[0] - 1) / 2, (CORNERS[1] - 1) / 2, 0]) * SQUARE_MM
        tilt = Rotation.from_euler("xyz", self.rng.uniform(-28, 28, 3), degrees=True)
        turn = Rotation.from_euler("y", -14.5, degrees=True) * tilt
        at = np.array([*self.rng.uniform(-6, 6, 2), 300 + self.rng.uniform(-15, 15)])
        board = placed(turn, at - turn.apply(middle))
        left, right = (
            board_image(np.linalg.inv(place) @ board, CORNERS, SQUARE_MM, matrix, distortion, self.rng, SIZE)
            for place, matrix, distortion in zip(CAMERAS, MATRICES, DISTORTIONS, strict=True)
        )
        return left, right


def write_session(case: Path, out: Path) -> None:
    """Write all recordings of a session about the phantom in ``case`` to the new folder ``out``."""
    session = Session.of_case(case, SESSION_SEED)
    out.mkdir(parents=True)
    head, beside = session.head_mm, session.beside_mm
    pivoting = [session.about(beside, 35) for _ in range(PIVOT_POSES)]
    _write_poses(out / "pivot.csv", [session.tracked(pose) for pose in pivoting])
    driven = [session.about(beside, 40, 80) for _ in range(HAND_EYE_POSES)]
    _write_poses(out / "hand_eye_tracker.csv", [session.tracked(pose) for pose in driven])
    _write_poses(out / "hand_eye_robot.csv", [session.told(pose) for pose in driven])
    rest = session.about(beside, 10)
    _write_poses(out / "rest_tracker.csv", [session.tracked(rest)] * REST_FRAMES)
    _write_poses(out / "rest_robot.csv", [session.told(rest)])
    _write_images(out / "boards", [session.board() for _ in range(BOARDS)])
    _write_looks(out, "sphere", session, [beside] * LOOKS, 30)
    _write_looks(out, "markers", session, list(head), 15)
    _write_tool(out / "tool.json")
    truth = {
        "format": "phantoms.robot-session",
        "version": 1,
        "unit": "mm",
        "robot_from_ots": session.robot_from_ots.tolist(),
        "robot_from_ct": (session.robot_from_ots @ session.ots_from_ct).tolist(),
        "m_from_tcp": session.m_from_tcp.tolist(),
        "tcp_from_rig": session.tcp_from_rig.tolist(),
        "markers": dict(zip(session.labels, head.tolist(), strict=True)),
    }
    (out / "truth.json").write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8")


def _write_looks(out: Path, name: str, session: Session, places: list[FloatArray], tilt_deg: float) -> None:
    poses = [session.about(place, tilt_deg, 4) for place in places]
    _write_images(out / name, [session.look(pose, place) for pose, place in zip(poses, places, strict=True)])
    _write_poses(out / f"{name}_robot.csv", [session.told(pose) for pose in poses])


def _write_poses(path: Path, poses: list[FloatArray]) -> None:
    names = [f"m{row}{column}" for row in range(4) for column in range(4)]
    rows = [",".join([str(k), *(f"{value:.9f}" for value in pose.ravel())]) for k, pose in enumerate(poses)]
    path.write_text("\n".join([",".join(["frame", *names]), *rows, ""]), encoding="utf-8")


def _write_images(folder: Path, pairs: list[tuple[FloatArray, FloatArray]]) -> None:
    for side, name in enumerate(("left", "right")):
        (folder / name).mkdir(parents=True)
        for number, pair in enumerate(pairs):
            Image.fromarray(pair[side].astype(np.uint8)).save(
                folder / name / f"{number:03d}.png", compress_level=1
            )


def _write_tool(path: Path) -> None:
    tool = {"format": "ronnaplan.template", "version": 1, "unit": "mm", "name": "tool", "labels": list("ABCD")}
    path.write_text(json.dumps({**tool, "centers": M_SPHERES_MM.tolist()}) + "\n", encoding="utf-8")


def case_argument(text: str) -> Path:
    """Return the folder of a phantom that is named on the command line."""
    if not (Path(text) / READINGS_TRUTH).is_file():
        raise ArgumentTypeError(f"{text} holds no {READINGS_TRUTH}; name a folder that does (data/synthetic_ct)")
    return Path(text)


def _new_folder(text: str) -> Path:
    if Path(text).exists():
        raise ArgumentTypeError(f"{text} is there already; name a new folder")
    return Path(text)


def main(arguments: list[str]) -> None:
    """Write a session as told on the command line."""
    parser = ArgumentParser(
        "python -m phantoms.robot_session", description="Write what a robot's session records."
    )
    parser.add_argument(
        "case", metavar="CASE", type=case_argument, help=f"a phantom's folder with its {READINGS_TRUTH}"
    )
    parser.add_argument("session", metavar="SESSION", type=_new_folder, help="the new folder to write")
    told = parser.parse_args(arguments)
    write_session(told.case, told.session)


if __name__ == "__main__":
    main(sys.argv[1:])
