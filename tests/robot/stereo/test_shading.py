"""How the fit of a whole sphere settles."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.robot.stereo import shading
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.circles import Image
from ronnaplan.robot.stereo.outline import find_cones
from ronnaplan.robot.stereo.shading import ShadedSphere, find_shaded
from ronnaplan.robot.stereo.shading_again import in_own_shadow
from tests.long import few_and_others
from tests.robot.stereo.stereo_views import rendered


def seen(scene: str, seed: int, side: int) -> tuple[Image, Camera, np.ndarray]:
    """Return the image and camera of a ``side``, and the true center (3,) in the camera's frame."""
    view, rig = rendered(scene, seed)
    camera = (rig.left, rig.right)[side]
    return (
        (view.left, view.right)[side],
        camera,
        camera.rig_from_camera[:3, :3].T @ (view.center_mm - camera.center_mm),
    )


def fitted(image: Image, camera: Camera) -> ShadedSphere:
    cone = find_cones(image, camera)[0]
    found = find_shaded(image, camera, cone.direction, cone.half_angle, cone.rays)
    assert found is not None
    return found


PROFILE = (
    "from ronnaplan.robot.stereo.profiles_compiled import blurred\n"
    "print(blurred(37.0, 1.3, -16.0, 0.1, 640).tobytes().hex())\n"
)


def test_a_profile_is_the_same_to_the_last_digit_in_the_run_that_compiles_it_and_in_later_ones(
    tmp_path: Path,
) -> None:
    """What blurs it stood in two copies of machine code, which may round otherwise: later runs took the other one."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, later = (
        subprocess.run([sys.executable, "-c", PROFILE], env=environment, capture_output=True, check=True).stdout
        for _ in range(2)
    )
    assert first
    assert first == later


def off_px(found: ShadedSphere, camera: Camera, center: np.ndarray) -> float:
    """Return how far from the true center the sphere is, in any light."""
    toward = found.expected + found.across @ found.place[:2]
    return (
        float(np.linalg.norm(toward / np.linalg.norm(toward) - center / np.linalg.norm(center))) * camera.focal_px
    )


@pytest.mark.parametrize("seed", [3008, 3011])
def test_a_limb_as_dark_as_the_ground_settles(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In whole steps its center went to and fro by up to 0.02 pixels, and the last of them was taken."""
    image, camera, _ = seen("limb darkens as the cosine", seed, 0)
    places = []
    for steps in (15, 16):
        monkeypatch.setattr(shading, "STEPS", steps)
        places.append(fitted(image, camera).place * camera.focal_px)
    np.testing.assert_allclose(places[0], places[1], atol=1e-3)


@few_and_others(("seed", "side"), [(3002, 1)], [(3010, 1), (3014, 1)])
def test_a_ball_in_its_own_shadow_keeps_its_outline(seed: int, side: int) -> None:
    """Where its lamp was first sought to no side, up to half of the outline was left out, or none of it found."""
    image, camera, center = seen("lit from aside", seed, side)
    found = in_own_shadow(fitted(image, camera))
    assert found is not None
    assert found.kept.mean() > 0.9
    assert off_px(found, camera, center) < 0.06
