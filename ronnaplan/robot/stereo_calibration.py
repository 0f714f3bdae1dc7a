"""Calibration of the stereo pair: the cameras from images of a board, the TCP from one sphere seen often."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, as_points
from ronnaplan.pose import Pose, adjoint, as_poses, as_stack, exponential, invert, rigid
from ronnaplan.robot.camera import HALVES, RIG, Camera, StereoRig, farthest
from ronnaplan.robot.chain import TCP
from ronnaplan.robot.circles import Image
from ronnaplan.robot.hand_eye import require_two_axes
from ronnaplan.robot.stereo import StereoSphere

FEWEST_BOARDS = 6
FEWEST_SPHERES = 6
SMALLEST_TILT_DEG = 8.0
"""RMS tilt of the boards against each other that they need; parallel ones leave focal length and distance open."""
LARGEST_RMS_PX = 1.0
"""Corners are found to a tenth of a pixel: boards that miss by more do not belong together."""
LARGEST_SD_MM = 0.5
"""A resting sphere's places scatter by less: those that do not come of poses of other moments, or in other units."""
LARGEST_SIZE_ERROR = 0.01
"""What a sphere's diameter and its outlines say of its distance is within 0.004 of what the cameras' lines say."""
BRIGHTEST_PERCENT = (100, 95)
"""What is brighter than so much of the image is taken for white when boards are looked for: nothing at first, then a
retro-reflective marker or another highlight, beside which a board may be too dark to be found."""
LEAST_REACH = 0.45
"""So much of the way from the image's middle to its corners boards reach in each half, for what lies beyond is
extrapolated. Of 48 calibrations on boards here or there the 23 whose boards did left no place within more than 0.02 mm
off; of the others, as of small boards in the middle or on one side, a third of the places within were."""
SMALLEST_INFORMATION = 1e-6
"""Smallest over largest eigenvalue of the scaled normal matrix for poses that determine ``tcp_from_rig``."""


@dataclass(frozen=True)
class StereoCalibration:
    """Two calibrated cameras and the RMS distance of the board's corners from their modelled places."""

    left: Camera
    right: Camera
    rms_px: float
    boards_used: int

    @property
    def doubts(self) -> tuple[str, ...]:
        """Where in the images it does not hold."""
        return tuple(
            f"in the {HALVES[int(np.argmin(camera.reach))]} half of the {side} image the boards reach out to "
            f"{min(camera.reach):.0%} of the way from its middle to its corners, expected {LEAST_REACH:.0%} or more: "
            "how the lens bends what lies farther out is not known, and spheres there are refused; take boards there, "
            "too, or keep spheres within"
            for side, camera in (("left", self.left), ("right", self.right))
            if camera.reach is not None and min(camera.reach) < LEAST_REACH
        )


@dataclass(frozen=True, eq=False)
class TcpCalibration:
    """Where the rig is on the robot, from one resting sphere."""

    tcp_from_rig: Pose
    sphere_robot_mm: FloatArray
    """The sphere (3,) in R."""
    rms_mm: float
    """RMS distance between the sphere's places found from the poses."""
    sd_mm: float
    """Standard deviation per axis of such a place."""


def calibrate_on_board(
    left: Sequence[Image], right: Sequence[Image], *, corners: tuple[int, int], square_mm: float
) -> StereoCalibration:
    """Return both cameras from simultaneous images of a chessboard with ``corners`` inner corners (columns, rows).

    Images in which either camera does not see the whole board are left out. Raises `InputError` if fewer than
    `FEWEST_BOARDS` remain, they hardly tilt against each other, or the images' sizes differ.
    """
    import cv2

    if len(left) != len(right) or len({np.asarray(image).shape for image in (*left, *right)}) != 1:
        raise InputError("the board images are not pairs of one size; expected as many left as right ones")
    seen = _seen_by_both(left, right, corners)
    grid = np.zeros((corners[0] * corners[1], 3), np.float32)
    grid[:, :2] = np.mgrid[: corners[0], : corners[1]].T.reshape(-1, 2) * square_mm
    boards = [grid] * len(seen)
    rows, columns = np.asarray(left[0]).shape
    size = columns, rows
    firsts, seconds = [a for a, _ in seen], [b for _, b in seen]
    _, k_left, d_left, turns, _ = cv2.calibrateCamera(boards, firsts, size, None, None)
    _require_tilts(_turns(turns))
    _, k_right, d_right, others, _ = cv2.calibrateCamera(boards, seconds, size, None, None)
    quarters = _quarters_apart(exponential(_turns(turns)), exponential(_turns(others)), corners[0] == corners[1])
    seconds = [_recounted(one, corners, turned) for one, turned in zip(seconds, quarters, strict=True)]
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)
    found = cv2.stereoCalibrate(
        boards, firsts, seconds, k_left, d_left, k_right, d_right, size,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS, criteria=criteria,
    )  # fmt: skip
    rms, k_left, d_left, k_right, d_right, rotation, shift = found[:7]
    if rms > LARGEST_RMS_PX:
        raise InputError(
            f"the board images contradict each other by {rms:.1f} pixels RMS, expected at most {LARGEST_RMS_PX:g}; "
            "check that left and right images belong together and that no camera moved between them"
        )
    right_from_left = rigid(_floats(rotation), _floats(shift).ravel())
    return StereoCalibration(
        Camera(_floats(k_left), _floats(d_left).ravel(), np.eye(4), size, _reach(firsts, size)),
        Camera(_floats(k_right), _floats(d_right).ravel(), invert(right_from_left), size, _reach(seconds, size)),
        float(rms),
        len(seen),
    )


def calibrate_tcp(robot_from_tcp: ArrayLike, spheres_mm: ArrayLike) -> TcpCalibration:
    """Return the rig's place on the robot from one resting sphere seen at many robot poses.

    ``robot_from_tcp`` (N, 4, 4) are the robot's poses and ``spheres_mm`` (N, 3) the sphere's center in the rig at
    each. Every pose gives ``robot_from_tcp @ tcp_from_rig @ sphere = constant``. Raises `InputError` for
    fewer than `FEWEST_SPHERES` poses or poses that turn or move too little, `RefusedError` where the sphere did not
    rest.
    """
    spheres = as_points(spheres_mm, "spheres")
    offered = as_stack(robot_from_tcp, "the robot poses")
    if len(offered) != len(spheres) or len(spheres) < FEWEST_SPHERES:
        raise InputError(
            f"{len(offered)} robot poses came with {len(spheres)} spheres; expected {FEWEST_SPHERES} or more each"
        )
    poses = as_poses(offered, "robot_from_tcp")
    require_two_axes(poses[:, :3, :3], "where the rig is")
    found = _refine(poses, spheres, _start(poses, spheres))
    if found.sd_mm > LARGEST_SD_MM:
        raise RefusedError(
            f"the sphere did not rest, or poses and images do not belong together: its places in R scatter by "
            f"{found.sd_mm:.2g} mm per axis, expected at most {LARGEST_SD_MM:g}; check the frames' numbers, that the "
            "robot's poses are in mm, and that no camera mirrors its images"
        )
    return found


def require_size(spheres: Sequence[StereoSphere], rig: StereoRig, diameter_mm: float) -> None:
    """Raise `RefusedError` where spheres of ``diameter_mm`` contradict the scale that the board gave the cameras."""
    ratio = 1 + float(np.mean([sphere.size_errors(rig, diameter_mm) for sphere in spheres]))
    if abs(ratio - 1) > LARGEST_SIZE_ERROR:
        side = "nearer" if ratio > 1 else "farther"
        raise RefusedError(
            f"the board puts the resting sphere {100 * abs(1 / ratio - 1):.1f} % {side} than a sphere of "
            f"{diameter_mm:g} mm is by its outlines; check the side of the board's squares and the diameter"
        )


def _turns(vectors: object) -> FloatArray:
    """Return OpenCV's rotation vectors as (N, 3)."""
    return np.array(vectors, dtype=np.float64).reshape(-1, 3)


def _quarters_apart(left: FloatArray, right: FloatArray, square: bool) -> list[int]:
    """Return by how many quarter turns the right camera counts each board's corners otherwise than the left.

    Boards are seen with rotations (N, 3, 3). One that looks the same upside down, or on its side where it is
    ``square``, has several first corners, and the cameras may not have taken the same. The cameras rest against each
    other, so the choice is the one with the steadiest rotation between them.
    """
    from scipy.spatial.transform import Rotation

    counts = (0, 1, 2, 3) if square else (0, 2)
    turns = exponential(np.outer(counts, (0.0, 0.0, np.pi / 2)))
    choices = right @ turns[:, None] @ left.swapaxes(1, 2)
    angles: list[list[FloatArray]] = [
        [np.atleast_1d(Rotation.from_matrix(reference.T @ choice).magnitude()) for choice in choices]
        for reference in choices[:, 0]
    ]
    best = min(angles, key=lambda one: float(np.min(one, axis=0).sum()))
    return [counts[n] for n in np.argmin(best, axis=0)]


def _reach(seen: list[FloatArray], size: tuple[int, int]) -> tuple[float, ...]:
    """Return how far out the boards' corners are ``seen`` in each half of images of ``size`` (columns, rows)."""
    return farthest(np.concatenate(seen).reshape(-1, 2), size)


def _recounted(seen: FloatArray, corners: tuple[int, int], quarters: int) -> FloatArray:
    """Return the places of a board's corners, row by row, in the order in which they are counted ``quarters`` on."""
    columns, rows = corners
    return np.rot90(seen.reshape(rows, columns, 2), quarters).reshape(seen.shape)


def _require_tilts(turns: FloatArray) -> None:
    """Raise `InputError` unless boards turned by rotation vectors (N, 3) tilt against each other."""
    normals = exponential(turns)[:, :, 2]
    spread = np.linalg.svd(normals - normals.mean(axis=0), compute_uv=False)[0] / np.sqrt(len(normals))
    tilt = float(np.degrees(spread))
    if tilt < SMALLEST_TILT_DEG:
        raise InputError(
            f"the board images do not determine the cameras: the boards tilt by {tilt:.2g} degrees RMS against each "
            f"other, expected {SMALLEST_TILT_DEG:g} or more; tilt the board by 20 degrees and more to all sides"
        )


def _floats(values: object) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


def _seen_by_both(
    left: Sequence[Image], right: Sequence[Image], corners: tuple[int, int]
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the corners in each pair of images that shows the whole board; raises `InputError` for too few pairs."""
    pairs = [(_corners(a, corners), _corners(b, corners)) for a, b in zip(left, right, strict=True)]
    seen = [(a, b) for a, b in pairs if a is not None and b is not None]
    if len(seen) < FEWEST_BOARDS:
        raise InputError(
            f"the whole board is seen in {len(seen)} image pairs; expected {FEWEST_BOARDS} or more of a plain "
            f"chessboard (no ChArUco) of {corners[0]} x {corners[1]} inner corners, all of it in both images"
        )
    return seen


def _corners(image: Image, corners: tuple[int, int]) -> FloatArray | None:
    import cv2

    grey = np.asarray(image, dtype=np.float64)
    for white in np.percentile(grey, BRIGHTEST_PERCENT):
        scaled = np.clip(grey * (255 / max(float(white), 1e-9)), 0, 255).astype(np.uint8)
        found, places = cv2.findChessboardCornersSB(scaled, corners, flags=cv2.CALIB_CB_ACCURACY)
        if found:
            return np.asarray(places)
    return None


def _start(poses: FloatArray, spheres: FloatArray) -> FloatArray:
    """Return ``tcp_from_rig`` (4, 4) from the equation made linear in the rotation's nine entries."""
    count = len(poses)
    rotation = poses[:, :3, :3]
    middle = spheres.mean(axis=0)
    # rows: rotation @ (B @ sphere + b) - s = -translation, with B's entries row by row
    entries = np.einsum("nij,nk->nijk", rotation, spheres - middle).reshape(count, 3, 9)
    design = np.concatenate([entries, rotation, np.broadcast_to(-np.eye(3), (count, 3, 3))], axis=2).reshape(
        -1, 15
    )
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0.0] = 1.0  # of spheres that are all in one plane, or place, the rank tells
    solution, _, rank, _ = np.linalg.lstsq(design / scale, -poses[:, :3, 3].ravel(), rcond=1e-9)
    if rank < 15:
        raise InputError(
            "the robot poses do not determine where the rig is; turn and move the robot about all axes"
        )
    full = solution / scale
    u, _, vt = np.linalg.svd(full[:9].reshape(3, 3))
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return rigid(turn, full[9:12] - turn @ middle)


def _refine(poses: FloatArray, spheres: FloatArray, start: FloatArray) -> TcpCalibration:
    from scipy.optimize import least_squares

    def places(x: FloatArray) -> FloatArray:
        inner = start @ rigid(exponential(x[:3]), x[3:6])
        in_tcp = spheres @ inner[:3, :3].T + inner[:3, 3]
        mapped: FloatArray = np.einsum("nij,nj->ni", poses[:, :3, :3], in_tcp) + poses[:, :3, 3]
        return mapped

    def misfit(x: FloatArray) -> FloatArray:
        return (places(x) - x[6:]).ravel()

    guess = np.concatenate([np.zeros(6), places(np.zeros(6)).mean(axis=0)])
    fit = least_squares(misfit, guess, x_scale=np.repeat([1e-3, 1, 1], 3))
    jacobian = np.asarray(fit.jac)
    information = jacobian.T @ jacobian
    scaled = information / np.sqrt(np.outer(np.diag(information), np.diag(information)))
    spectrum = np.linalg.eigvalsh(scaled)
    if spectrum[0] < SMALLEST_INFORMATION * spectrum[-1]:
        raise InputError(
            "the robot poses do not determine where the rig is; turn and move the robot about all axes"
        )
    variance = 2 * float(fit.cost) / (spheres.size - 9)
    matrix = start @ rigid(exponential(fit.x[:3]), fit.x[3:6])
    carry = adjoint(matrix)
    covariance = carry @ (np.linalg.inv(information)[:6, :6] * variance) @ carry.T
    rms = float(np.sqrt(2 * fit.cost / len(spheres)))
    return TcpCalibration(Pose(matrix, covariance, TCP, RIG), fit.x[6:], rms, float(np.sqrt(variance)))
