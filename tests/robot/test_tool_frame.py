"""The tool is recognized among single spheres and its pose is that of its geometry."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import RefusedError
from ronnaplan.geometry import Frame, Points
from ronnaplan.robot.tool_frame import locate_tool

CROSS = np.array([[0.0, 60, 0], [45, 0, 0], [0, -75, 0], [-90, 0, 0]])
M, OTS = Frame("M"), Frame("OTS")


def geometry(spheres: np.ndarray) -> Points:
    labels = tuple(f"S{k + 1}" for k in range(len(spheres)))
    return Points(spheres, np.tile(0.02**2 * np.eye(3), (len(spheres), 1, 1)), labels, M)


def readings(spheres: np.ndarray, seed: int) -> tuple[Points, np.ndarray]:
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(rng=rng).as_matrix(), (100, -50, -1500)
    seen = spheres @ pose[:3, :3].T + pose[:3, 3] + rng.normal(size=spheres.shape) * 0.1
    others = rng.uniform(-200, 200, (3, 3)) - (0, 0, 1500)
    everything = np.vstack([others, seen])[rng.permutation(len(spheres) + 3)]
    count = len(everything)
    labels = tuple(str(k) for k in range(count))
    return Points(everything, np.tile(0.1**2 * np.eye(3), (count, 1, 1)), labels, OTS), pose


def test_the_x_shaped_frame_is_found_among_other_markers() -> None:
    errors = []
    for seed in range(20):
        seen, truth = readings(CROSS, seed)
        registration = locate_tool(geometry(CROSS), seen, expected=4).registration
        assert registration is not None
        assert (registration.pose.to_frame, registration.pose.from_frame) == (OTS, M)
        off = registration.pose.apply([[0, 0, 150]])[0] - truth[:3, :3] @ (0, 0, 150) - truth[:3, 3]
        spread = registration.tre([[0, 0, 150]])[0]
        errors.append(off @ np.linalg.solve(spread, off))
    assert 1.5 < np.mean(errors) < 5  # 3 expected


def test_a_symmetric_frame_has_no_pose() -> None:
    square = np.array([[50.0, 0, 0], [0, 50, 0], [-50, 0, 0], [0, -50, 0]])
    with pytest.raises(RefusedError, match="tool M is not recognized"):
        locate_tool(geometry(square), readings(square, 1)[0], expected=4)
