"""Views of a ball before two cameras, by code that shares nothing with what measures it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from phantoms import cameras as rendering
from phantoms.stereo_kinds import SCENES
from phantoms.stereo_scenes import SceneRig, View, random_rig, render
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import TCP
from ronnaplan.robot.stereo.camera import RIG, Boards, Camera, StereoRig
from ronnaplan.robot.stereo.sphere import StereoSphere
from ronnaplan.transforms import invert

DIAMETER = 11.5
K = [
    np.array([[4200.0, 0, 650], [0, 4195, 500], [0, 0, 1]]),
    np.array([[4230.0, 0, 630], [0, 4240, 520], [0, 0, 1]]),
]
D = [np.array([-0.12, 0.2, 8e-4, -5e-4, 0.05]), np.array([-0.15, 0.1, -6e-4, 7e-4, 0])]


def placed(x_mm: float, turn_deg: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0, np.radians(turn_deg), 0]).as_matrix()
    matrix[:3, 3] = (x_mm, 0, 0)
    return matrix


RIGHT = placed(155.0, -29.0)
RIG_EXACT = StereoRig(Camera(K[0], D[0], np.eye(4)), Camera(K[1], D[1], RIGHT), Pose.exact(np.eye(4), TCP, RIG))


def moved(matrix: np.ndarray, point: np.ndarray) -> np.ndarray:
    found: np.ndarray = matrix[:3, :3] @ point + matrix[:3, 3]
    return found


def about_limb(side: int, rays: np.ndarray, center_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many pixels outside a ball's outline unit ``rays`` (J, I, 3) of a camera are, in which direction (rad)."""
    to_ball = moved(invert((np.eye(4), RIGHT)[side]), center_mm)
    far = np.linalg.norm(to_ball)
    toward = to_ball / far
    out_px = (np.arccos(np.clip(rays @ toward, -1, 1)) - np.arcsin(DIAMETER / 2 / far)) * K[side][0, 0]
    return out_px, np.arctan2(*(rays @ np.linalg.svd(toward[None])[2][1:].T).transpose(2, 0, 1))


def read(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An image (J, I) of eight bits, with noise."""
    return np.asarray(np.rint(np.clip(180 * light + rng.normal(size=light.shape) * 1.5, 0, 255)), dtype=np.uint8)


def normalized_error(found: StereoSphere, center_mm: np.ndarray) -> float:
    """The squared error of what was found by what is stated of it, 1 on average."""
    error = found.position_mm - center_mm
    return float(error @ np.linalg.solve(found.covariance_mm2, error) / 3)


def seen(centers: list[np.ndarray], rng: np.random.Generator, **how: Any) -> tuple[np.ndarray, np.ndarray]:
    left, right = (
        rendering.sphere_image([moved(invert(place), c) for c in centers], DIAMETER, K[i], D[i], rng, **how)
        for i, place in enumerate((np.eye(4), RIGHT))
    )
    return left, right


def rendered(name: str, seed: int) -> tuple[View, StereoRig]:
    scene = next(one for one in SCENES if one.name == name)
    rng = np.random.default_rng([seed, SCENES.index(scene)])
    drawn = random_rig(rng)
    return render(scene, drawn, rng), calibrated(drawn)


def calibrated(rig: SceneRig) -> StereoRig:
    left, right = (Camera(*one) for one in zip(rig.matrices, rig.distortions, rig.places, strict=True))
    return StereoRig(left, right, Pose.exact(np.eye(4), TCP, RIG))


def on_boards(rig: StereoRig, middle_mm: np.ndarray, square_mm: float, error_px: float) -> StereoRig:
    """The same cameras, of which is known what eight tilted boards about a place told."""
    rng = np.random.default_rng(4)
    places = np.tile(np.eye(4), (8, 1, 1))
    places[:, :3, :3] = Rotation.from_euler("xyz", rng.uniform(-28, 28, (8, 3)), degrees=True).as_matrix()
    places[:, :3, 3] = middle_mm - places[:, :3, :3] @ [4 * square_mm, 3 * square_mm, 0]
    size = rendering.SIZE[1], rendering.SIZE[0]
    left, right = (replace(one, size_px=size) for one in (rig.left, rig.right))
    return StereoRig(left, right, rig.tcp_from_rig, Boards((9, 7), square_mm, places, error_px, 0.0))
