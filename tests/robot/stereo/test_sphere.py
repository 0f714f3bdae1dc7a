"""Stereo re-localization of an evenly bright sphere, on images rendered by independent code."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from phantoms import cameras as rendering
from ronnaplan.errors import FrameMismatchError, InputError, RefusedError, UsageError
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import TCP, R
from ronnaplan.robot.stereo.camera import RIG, Camera, StereoRig
from ronnaplan.robot.stereo.outline import find_cones, find_outlines
from ronnaplan.robot.stereo.sphere import StereoSphere, locate_sphere
from ronnaplan.transforms import invert
from tests.long import few_and_others, few_or_all
from tests.robot.stereo.stereo_views import (
    DIAMETER,
    RIG_EXACT,
    RIGHT,
    D,
    K,
    moved,
    on_boards,
    placed,
    rendered,
    seen,
)


@cache
def trials(count: int) -> list[tuple[np.ndarray, StereoSphere]]:
    rng = np.random.default_rng(0)
    found = []
    for _ in range(count):
        center = np.array([rng.uniform(-12, 12), rng.uniform(-10, 10), 300 + rng.uniform(-8, 8)])
        images = seen([center], rng, blur_px=rng.uniform(0.8, 2.5), noise=rng.uniform(1, 4), strays=6)
        found.append((center, locate_sphere(*images, RIG_EXACT, diameter_mm=DIAMETER)))
    return found


@few_or_all("count", 6, 12)
def test_the_error_at_300_mm_is_at_most_a_fiftieth_of_a_millimetre(count: int) -> None:
    """With lens distortion, blur, noise and stray reflections."""
    errors = [np.linalg.norm(sphere.position_mm - center) for center, sphere in trials(count)]
    assert max(errors) <= 0.02


@few_or_all("count", 6, 12)
def test_the_errors_are_as_large_as_their_covariance_says(count: int) -> None:
    distances = []
    for center, sphere in trials(count):
        error = sphere.position_mm - center
        distances.append(error @ np.linalg.solve(sphere.covariance_mm2, error))
    assert 1.0 < np.mean(distances) < 6.0  # 3 expected


def test_the_direction_has_no_ellipse_center_bias() -> None:
    """A near sphere far off a wide camera's axis: the ellipse's center is not its center's image."""
    matrix, none = np.array([[900.0, 0, 640], [0, 900, 512], [0, 0, 1]]), np.zeros(5)
    center = np.array([38.0, 20, 70])
    camera = Camera(matrix, none, np.eye(4))
    image = rendering.sphere_image([center], DIAMETER, matrix, none, np.random.default_rng(1), samples=6)
    outline = find_outlines(image, camera)[0]
    angle = np.arccos(np.clip(outline.direction @ center / np.linalg.norm(center), -1, 1))
    contours, _ = cv2.findContours(
        (image > image.max() / 4).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    ellipse = np.array(cv2.fitEllipse(max(contours, key=len))[0])
    bias_px = np.linalg.norm(ellipse - rendering.project(center, matrix, none))
    assert bias_px > 0.3
    assert angle * camera.focal_px < 0.03
    assert outline.distance_mm(DIAMETER) == pytest.approx(np.linalg.norm(center), rel=0.01)


def test_a_reflection_over_part_of_the_outline_does_not_pull_the_center() -> None:
    rng = np.random.default_rng(2)
    center = np.array([3.0, -2, 300])
    images = seen([center], rng)
    at = rendering.project(center, K[0], D[0]).astype(int)
    images[0][at[1] - 10 : at[1] + 12, at[0] + 60 : at[0] + 130] = 200
    found = locate_sphere(*images, RIG_EXACT, diameter_mm=DIAMETER)
    assert np.linalg.norm(found.position_mm - center) < 0.02


@few_and_others("side", ["right"], ["top"])
def test_a_hidden_fifth_of_the_outline_does_not_pull_the_center(side: str) -> None:
    rng = np.random.default_rng(8)
    center = np.array([2.0, 3, 300])
    images = seen([center], rng)
    at = rendering.project(center, K[0], D[0]).astype(int)
    if side == "right":
        images[0][:, at[0] + 65 :] = 12
    else:
        images[0][: at[1] - 65] = 12
    found = locate_sphere(*images, RIG_EXACT, diameter_mm=DIAMETER)
    assert np.linalg.norm(found.position_mm - center) < 0.02


def test_uneven_light_does_not_pull_the_center() -> None:
    """Brightness that falls by a third across the sphere: every part of the edge has its own half height."""
    rng = np.random.default_rng(9)
    center = np.array([-3.0, 2, 300])
    images = seen([center], rng)
    for image, (k, d, place) in zip(images, zip(K, D, (np.eye(4), RIGHT), strict=True), strict=True):
        at = rendering.project(moved(invert(place), center), k, d)[0]
        fall = 1 - 0.15 * (np.arange(image.shape[1]) - at) / 80
        image[:] = np.clip(image * np.clip(fall, 0.5, 1.3), 0, 255).astype(np.uint8)
    found = locate_sphere(*images, RIG_EXACT, diameter_mm=DIAMETER)
    assert np.linalg.norm(found.position_mm - center) < 0.01


@few_and_others("seed", [5], [16, 21])
def test_what_an_overexposed_ball_does_not_tell_is_stated(seed: int) -> None:
    """Its middle reads alike however unevenly it is lit, so that no misfit shows how far the center is off."""
    view, rig = rendered("overexposed, gradient", seed)
    found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER)
    off = found.position_mm - view.center_mm
    assert off @ np.linalg.solve(found.covariance_mm2, off) / 3 < 2.5  # 4.7 to 7.4 by the noise at the limb


def test_an_evenly_bright_sphere_is_as_large_as_it_is() -> None:
    """To a hundredth of a pixel: where the edge lay half a step of the model's table too deep, by five too small."""
    off_px = []
    for seed in range(3):
        view, rig = rendered("evenly bright", seed)
        found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER)
        for camera, outline in ((rig.left, found.left), (rig.right, found.right)):
            far_mm = np.linalg.norm(view.center_mm - camera.center_mm)
            off_px.append((outline.half_angle - np.arcsin(DIAMETER / 2 / far_mm)) * camera.focal_px)
    assert abs(np.mean(off_px)) < 0.015


def test_a_blurred_sphere_is_told_to_be_no_sharp_one() -> None:
    """Of an image that moved by 12 pixels meanwhile: no camera that comes closer mends that."""
    sharp = seen([np.array([2.0, 3, 300])], np.random.default_rng(3))
    left, right = (uniform_filter1d(image, 12, axis=1) for image in sharp)
    with pytest.raises(InputError, match=r"0 right\); edges agree on one in both images, but .* into focus"):
        locate_sphere(left, right, RIG_EXACT, diameter_mm=DIAMETER)


def test_a_sphere_that_one_camera_does_not_see_is_not_guessed() -> None:
    rng = np.random.default_rng(3)
    left, right = seen([np.array([3.0, -2, 300])], rng)
    dark = np.full_like(right, 10)
    with pytest.raises(InputError, match="1 outlines left, 0 right"):
        locate_sphere(left, dark, RIG_EXACT, diameter_mm=DIAMETER)
    with pytest.raises(
        InputError,
        match=rf"no sphere of 8 mm is seen .*, but what looks like one of {DIAMETER:g} mm: correct the dia.* or, where "
        "that is none, put a plain",
    ):
        locate_sphere(left, right, RIG_EXACT, diameter_mm=8.0)
    for wrong in ({"diameter_mm": 0.0}, {"diameter_mm": np.inf}, {"largest_mm": np.nan}):
        with pytest.raises(InputError, match="above zero"):
            locate_sphere(left, right, RIG_EXACT, **{"diameter_mm": DIAMETER, **wrong})
    for lamp_deg in (0.0, -1.0, np.nan, 90.0):  # of none a traceback, else another reason was told
        with pytest.raises(InputError, match=r"the lamp is .* degrees off the lens; expected above 0, up to 17.2"):
            locate_sphere(left, right, RIG_EXACT, diameter_mm=DIAMETER, lamp_sd_deg=lamp_deg)
    with pytest.raises(
        InputError, match=r"0 outlines left, 0 right.*, and put a plain and darker ground behind it"
    ):
        locate_sphere(dark, dark, RIG_EXACT, diameter_mm=DIAMETER)  # as before stripes, where nearer helps nothing


def test_a_sphere_of_another_size_is_told_of_no_size_where_the_cameras_disagree_on_it() -> None:
    """One camera's focal length is wrong, and the sphere is on its axis: no other diameter mends that."""
    images = seen([moved(RIGHT, np.array([0.0, 0, 340]))], np.random.default_rng(3))
    longer = np.diag([1.3, 1.3, 1.0]) @ K[1]
    longer[:2, 2] = K[1][:2, 2]
    off = StereoRig(Camera(K[0], D[0], np.eye(4)), Camera(longer, D[1], RIGHT), Pose.exact(np.eye(4), TCP, RIG))
    with pytest.raises(InputError, match=r"no sphere of 8 mm .* right\); check that left and right are"):
        locate_sphere(*images, off, diameter_mm=8.0)


def test_what_the_calibration_leaves_open_is_stated_beside_the_noise() -> None:
    center = np.array([9.0, -5, 300])
    images = seen([center], np.random.default_rng(3))
    exact = locate_sphere(*images, RIG_EXACT, diameter_mm=DIAMETER)
    rig = on_boards(RIG_EXACT, np.array([0.0, 0, 300]), 5.0, 0.02)
    found = locate_sphere(*images, rig, diameter_mm=DIAMETER)
    assert exact.calibration_mm2 == pytest.approx(np.zeros((3, 3)))
    assert 1e-8 < np.trace(found.calibration_mm2) < 1e-4
    np.testing.assert_allclose(found.position_mm, exact.position_mm, atol=1e-9)
    np.testing.assert_allclose(found.covariance_mm2 - found.calibration_mm2, exact.covariance_mm2, atol=1e-12)


def test_a_sphere_where_the_calibration_leaves_too_much_open_is_refused() -> None:
    """The boards are small, and about the middle; that is no fault of the light or the focus."""
    rig = on_boards(RIG_EXACT, np.array([0.0, 0, 300]), 3.0, 0.05)
    rng = np.random.default_rng(3)
    near = locate_sphere(*seen([np.array([1.0, 2, 300])], rng), rig, diameter_mm=DIAMETER)
    assert np.linalg.norm(near.position_mm - [1, 2, 300]) < 0.02
    far = seen([np.array([27.0, 17, 300])], rng)
    told = r"known to \d\.\d+ mm only; .* mm the cameras' calibration leaves open where it is; bring the sphere nearer"
    with pytest.raises(RefusedError, match=told):
        locate_sphere(*far, rig, diameter_mm=DIAMETER)
    locate_sphere(*far, RIG_EXACT, diameter_mm=DIAMETER)


@few_and_others("side", [0], [1])
def test_a_sphere_that_is_not_found_where_the_lens_is_not_known_is_told_to_be_there(side: int) -> None:
    """The lens is told so wrongly there that an outline is none: no camera moved closer mends that."""
    images = seen([np.array([27.0, 17, 300])], np.random.default_rng(3))
    rig = on_boards(RIG_EXACT, np.array([0.0, 0, 300]), 3.0, 0.05)
    cameras = [rig.left, rig.right]
    bent = cameras[side].distortion + np.array([0.0, 200, 0, 0, 0])
    cameras[side] = replace(cameras[side], distortion=bent)
    bent_rig = StereoRig(cameras[0], cameras[1], rig.tcp_from_rig, rig.boards)
    told = (
        r"no sphere of 11.5 mm .*: by .* mm the cameras' calibration leaves open where what looks most like one is"
    )
    with pytest.raises(InputError, match=told):
        locate_sphere(*images, bent_rig, diameter_mm=DIAMETER)


def test_images_of_the_other_camera_each_are_told_as_such() -> None:
    left, right = seen([np.array([3.0, -2, 300])], np.random.default_rng(3))
    with pytest.raises(InputError, match=r"no sphere of 11.5 mm .*1 outlines left, 1 right\); .* not exchanged"):
        locate_sphere(right, left, RIG_EXACT, diameter_mm=DIAMETER)


def test_cameras_that_were_moved_since_they_were_calibrated_are_told_as_such() -> None:
    """It was to be checked that the images are not exchanged, and the cameras to be moved closer."""
    images = seen([np.array([3.0, -2, 300])], np.random.default_rng(3))
    moved_by = np.eye(4)
    moved_by[:3, :3] = Rotation.from_rotvec([0.002, 0, 0]).as_matrix()
    rig = replace(RIG_EXACT, right=replace(RIG_EXACT.right, rig_from_camera=RIGHT @ moved_by))
    with pytest.raises(InputError, match=r"1 outlines left, 1 right\); edges agree on one .* if they were moved"):
        locate_sphere(*images, rig, diameter_mm=DIAMETER)


def test_two_spheres_are_refused() -> None:
    images = seen([np.array([-14.0, -8, 300]), np.array([14.0, 9, 300])], np.random.default_rng(4))
    with pytest.raises(RefusedError, match="2 spheres"):
        locate_sphere(*images, RIG_EXACT, diameter_mm=DIAMETER)


def test_what_is_no_grey_image_or_camera_is_named() -> None:
    for wrong in (np.zeros((100, 100, 3)), np.zeros((100, 100), complex), np.zeros((100, 100), object)):
        with pytest.raises(InputError, match="grey values"):
            find_outlines(wrong, RIG_EXACT.left)
    with pytest.raises(UsageError, match="list is given for a camera's image, expected ndarray"):
        locate_sphere([[0, 1]], [[0, 1]], RIG_EXACT, diameter_mm=DIAMETER)  # type: ignore[arg-type]
    assert find_outlines(np.zeros((100, 100)), RIG_EXACT.left) == []
    with pytest.raises(InputError, match="camera matrix"):
        Camera(np.zeros((3, 3)), np.zeros(5), np.eye(4))
    for focal_px in (0.0, -2000.0, 1e-300):  # the other one's, though their mean is positive
        with pytest.raises(InputError, match="positive focal lengths, of 1 pixel or more"):
            Camera(np.diag([focal_px, 2100.0, 1.0]), np.zeros(5), np.eye(4))


def test_the_sphere_is_expressed_in_the_robots_frame_with_all_errors() -> None:
    center, sphere = trials(6)[0]
    rng = np.random.default_rng(5)
    tcp_from_rig, robot_from_tcp = placed(40.0, 15.0), placed(900.0, -70.0)
    covariance = np.diag(np.repeat([1e-4**2, 0.01**2], 3))
    rig = StereoRig(RIG_EXACT.left, RIG_EXACT.right, Pose(tcp_from_rig, covariance, TCP, RIG))
    found = sphere.in_robot(rig, Pose(robot_from_tcp, covariance, R, TCP))
    assert found.frame == R
    np.testing.assert_allclose(
        found.positions_mm[0], moved(robot_from_tcp @ tcp_from_rig, sphere.position_mm), atol=1e-9
    )
    simulated = rng.multivariate_normal(sphere.position_mm, sphere.covariance_mm2, 5000)
    for place in (tcp_from_rig, robot_from_tcp):
        turns = Rotation.from_rotvec(rng.normal(size=(5000, 3)) * 1e-4)
        simulated = turns.apply(simulated @ place[:3, :3].T + place[:3, 3]) + rng.normal(size=(5000, 3)) * 0.01
    scatter = np.cov(simulated.T)
    assert np.abs(found.covariances_mm2[0] - scatter).max() < 0.06 * np.trace(scatter)
    with pytest.raises(FrameMismatchError):
        sphere.in_robot(rig, Pose.exact(np.eye(4), TCP, R))
    assert np.linalg.norm(sphere.position_mm - center) < 0.02


def test_edges_that_coincide_do_not_hide_the_outline_of_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    angles = 2.0 * np.pi * np.arange(90) / 90
    edges_px = K[0][:2, 2] + 60.0 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    edges_px[[30, 60]] = edges_px[0]  # a third of the outline apart
    monkeypatch.setattr(
        "ronnaplan.robot.stereo.outline.find_circles", lambda image: [SimpleNamespace(edges_px=edges_px)]
    )
    camera = Camera(K[0], np.zeros(5), np.eye(4))
    (cone,) = find_cones(np.zeros(rendering.SIZE[::-1]), camera)
    assert cone.half_angle == pytest.approx(np.arctan(60.0 / camera.focal_px), rel=1e-3)
    assert cone.direction == pytest.approx([0.0, 0.0, 1.0], abs=1e-3)
