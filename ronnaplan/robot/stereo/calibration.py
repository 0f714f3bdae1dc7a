"""Calibration of the stereo pair: the cameras from images of a board, the TCP from one sphere seen often."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.errors import InputError, RefusedError, check_type
from ronnaplan.geometry import FloatArray, as_points
from ronnaplan.pose import Pose, as_poses, as_stack
from ronnaplan.robot.chain import TCP
from ronnaplan.robot.hand_eye import require_two_axes
from ronnaplan.robot.misread import misread_as
from ronnaplan.robot.stereo.board import grid_mm, quarters_apart, recounted, require_board, seen_by_both
from ronnaplan.robot.stereo.calibration_errors import MEASURE_SQUARES, judged, known_share, with_exact_squares
from ronnaplan.robot.stereo.calibration_fit import UNDETERMINED as BOARDS_UNDETERMINED
from ronnaplan.robot.stereo.calibration_fit import Fit, fitted
from ronnaplan.robot.stereo.calibration_slip import require_rest
from ronnaplan.robot.stereo.camera import RIG, Boards, Camera, StereoRig
from ronnaplan.robot.stereo.circles import Image
from ronnaplan.robot.stereo.sphere import StereoSphere
from ronnaplan.sigmas import LARGEST_STATED_MM, SIGMA_SQUARE
from ronnaplan.transforms import carried, exponential, invert, nearest_rotations, rigid

FEWEST_SPHERES = 6
"""Poses of the robot at which the resting sphere is seen."""
SMALLEST_TILT_DEG = 8.0
"""RMS tilt of the boards against each other that they need; parallel ones leave focal length and distance open."""
LARGEST_RMS_PX = 1.0
"""Corners are found to a tenth of a pixel: boards that miss by more do not belong together."""
LARGEST_SD_MM = 0.5
"""A resting sphere's places scatter by less: those that do not come of poses of other moments, or in other units."""
LARGEST_SIZE_ERROR = 0.01
"""What a sphere's diameter and its outlines say of its distance is within 0.004 of what the cameras' lines say."""
LEAST_KNOWN = 0.6
"""In so much of what both cameras see spheres should be measured; where boards were all over the images it is more."""
MORE_BOARDS = (
    "take more boards, larger in the images and all over them, or keep spheres near the middle of the boards"
)
UNDETERMINED = "the robot poses do not determine where the rig is; turn and move the robot about all axes"
SMALLEST_INFORMATION = 1e-6
"""Smallest over largest eigenvalue of the scaled normal matrix for poses that determine ``tcp_from_rig``."""


@dataclass(frozen=True)
class StereoCalibration:
    """Two calibrated cameras and the RMS distance of the board's corners from their modelled places."""

    left: Camera
    right: Camera
    rms_px: float
    boards: Boards

    @property
    def boards_used(self) -> int:
        """How many boards both cameras saw."""
        return len(self.boards.rig_from_board)

    def rig(self, tcp_from_rig: Pose) -> StereoRig:
        """Return the cameras with the TCP at ``tcp_from_rig``."""
        return StereoRig(self.left, self.right, tcp_from_rig, self.boards)

    def doubts(self, largest_mm: float = LARGEST_STATED_MM) -> tuple[str, ...]:
        """Where in the images it does not tell spheres to ``largest_mm``, and what the corners say against it."""
        rig = self.rig(Pose.exact(np.eye(4), TCP, RIG))
        share, of_images = (known_share(one, largest_mm) for one in (rig, with_exact_squares(rig)))
        told = []
        if share < LEAST_KNOWN:
            told.append(
                f"the boards tell the cameras to {largest_mm:g} mm in {share:.0%} of what both see where the "
                f"boards were, expected {LEAST_KNOWN:.0%} or more: spheres elsewhere are refused; "
                + (MORE_BOARDS if of_images < LEAST_KNOWN else MEASURE_SQUARES)
            )
        if self.boards.lens_px > self.boards.error_px:
            told.append(
                f"the boards' corners are off by {self.boards.lens_px:.3f} pixels in smooth fields, expected no more "
                f"than their noise of {self.boards.error_px:.3f}: the board is wavy or changes its shape, or the "
                "lenses bend otherwise than their model; calibrate with a board on glass or metal"
            )
        return tuple(told)


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
    left: Sequence[Image],
    right: Sequence[Image],
    *,
    corners: tuple[int, int],
    square_mm: float,
    sigma_square: float = SIGMA_SQUARE,
) -> StereoCalibration:
    """Return both cameras from simultaneous images of a chessboard with ``corners`` inner corners (columns, rows).

    ``sigma_square`` is the standard error of ``square_mm``, as a part of it, which no image shows. Images in which
    either camera does not see the whole board are left out; the others are in the order of their time. Raises
    `InputError` for what is no board, if fewer than `FEWEST_BOARDS` remain, they hardly tilt against each other, or the
    images' sizes differ, and `RefusedError` if one camera moved against the other meanwhile.
    """
    require_board(corners, square_mm, sigma_square)
    _require_pairs(left, right)
    rows, columns = np.asarray(left[0]).shape
    cameras, seen = _by_opencv(seen_by_both(left, right, corners), corners, square_mm, (columns, rows))
    fit = fitted(cameras, seen, corners, square_mm)
    _require_told(fit)
    return StereoCalibration(*fit.cameras, fit.rms_px, judged(fit, square_mm, sigma_square))


def _by_opencv(
    seen: list[tuple[FloatArray, FloatArray]], corners: tuple[int, int], square_mm: float, size: tuple[int, int]
) -> tuple[tuple[Camera, Camera], list[tuple[FloatArray, FloatArray]]]:
    """Return cameras that flat boards ``seen`` (K, 1, 2) tell, and these with corners counted alike in both images."""
    import cv2

    boards = [grid_mm(corners, square_mm).astype(np.float32)] * len(seen)
    firsts, seconds = [a for a, _ in seen], [b for _, b in seen]
    _, k_left, d_left, turns, _ = cv2.calibrateCamera(boards, _singles(firsts), size, None, None)
    _require_tilts(_turns(turns))
    _, k_right, d_right, others, _ = cv2.calibrateCamera(boards, _singles(seconds), size, None, None)
    quarters = quarters_apart(exponential(_turns(turns)), exponential(_turns(others)), corners[0] == corners[1])
    seconds = [recounted(one, corners, turned) for one, turned in zip(seconds, quarters, strict=True)]
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)
    found = cv2.stereoCalibrate(
        boards, _singles(firsts), _singles(seconds), k_left, d_left, k_right, d_right, size,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS, criteria=criteria,
    )  # fmt: skip
    rms, k_left, d_left, k_right, d_right, rotation, shift = found[:7]
    if rms > LARGEST_RMS_PX:
        raise InputError(
            f"the board images contradict each other by {rms:.1f} pixels RMS, expected at most {LARGEST_RMS_PX:g}; "
            "check that left and right images belong together and that no camera moved between them"
        )
    right_from_left = rigid(_floats(rotation), _floats(shift).ravel())
    cameras = (
        Camera(_floats(k_left), _floats(d_left).ravel(), np.eye(4), size),
        Camera(_floats(k_right), _floats(d_right).ravel(), invert(right_from_left), size),
    )
    return cameras, list(zip(firsts, seconds, strict=True))


def _require_told(fit: Fit) -> None:
    """Raise an error where a camera moved, which may leave a ``fit`` unsettled, or where boards leave it open."""
    require_rest(fit)
    if not fit.settled:
        raise InputError(BOARDS_UNDETERMINED)


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
        said = (
            f"the sphere did not rest, or poses and images do not belong together: its places in R scatter by "
            f"{found.sd_mm:.2g} mm per axis, expected at most {LARGEST_SD_MM:g}"
        )
        if misread := misread_as(poses, lambda meant: _rests(meant, spheres)):
            raise RefusedError(
                f"{said}; it rested if in the robot's poses {misread}: turn them into matrices, or a quaternion, anew"
            )
        raise RefusedError(
            f"{said}; check the frames' numbers, that the robot's poses are in mm, how their rotations were turned "
            "into matrices (the order of angles, or of a quaternion's numbers), and that no camera mirrors its images"
        )
    return found


def _rests(poses: FloatArray, spheres: FloatArray) -> bool:
    """Whether ``spheres`` (N, 3) in the rig are one that rests in R, seen from ``poses`` (N, 4, 4)."""
    try:
        return _refine(poses, spheres, _start(poses, spheres)).sd_mm <= LARGEST_SD_MM
    except InputError:
        return False  # these poses do not tell


def require_size(spheres: Sequence[StereoSphere], rig: StereoRig, diameter_mm: float) -> None:
    """Raise `RefusedError` where spheres of ``diameter_mm`` contradict the scale that the board gave the cameras."""
    ratio = 1 + float(np.mean([sphere.size_errors(rig, diameter_mm) for sphere in spheres]))
    if abs(ratio - 1) > LARGEST_SIZE_ERROR:
        side = "nearer" if ratio > 1 else "farther"
        raise RefusedError(
            f"the board puts the resting sphere {100 * abs(1 / ratio - 1):.1f} % {side} than a sphere of "
            f"{diameter_mm:g} mm is by its outlines; check the side of the board's squares and the diameter"
        )


def _require_pairs(left: Sequence[Image], right: Sequence[Image]) -> None:
    """Raise `InputError` unless the board images are as many ``left`` as ``right`` ones, grey and of one size."""
    for images, side in ((left, "left"), (right, "right")):
        check_type(
            images, (Sequence, np.ndarray), f"the {side} camera's", "give an image of the board for each look"
        )
    sizes = {np.asarray(image).shape for image in (*left, *right)}
    if len(left) != len(right) or len(sizes) != 1 or len(sizes.pop()) != 2:
        raise InputError(
            "the board images are not pairs of one size; expected as many left as right ones, of grey values each"
        )


def _turns(vectors: object) -> FloatArray:
    """Return OpenCV's rotation vectors as (N, 3)."""
    return np.array(vectors, dtype=np.float64).reshape(-1, 3)


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


def _singles(places: list[FloatArray]) -> list[NDArray[np.float32]]:
    """Return places as OpenCV wants them."""
    return [one.astype(np.float32) for one in places]


def _floats(values: object) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


def _start(poses: FloatArray, spheres: FloatArray) -> FloatArray:
    """Return ``tcp_from_rig`` (4, 4) from the equation made linear in the rotation's nine entries."""
    count = len(poses)
    rotation = poses[:, :3, :3]
    middle = spheres.mean(axis=0)
    # rows: rotation @ (B @ sphere + b) - s = -translation, with B's entries row by row
    entries = np.einsum("nij,nk->nijk", rotation, spheres - middle).reshape(count, 3, 9)
    columns = np.concatenate([entries, rotation, np.broadcast_to(-np.eye(3), (count, 3, 3))], axis=2)
    design = columns.reshape(-1, columns.shape[2])
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0.0] = 1.0  # of spheres that are all in one plane, or place, the rank tells
    solution, _, rank, _ = np.linalg.lstsq(design / scale, -poses[:, :3, 3].ravel(), rcond=1e-9)
    if rank < design.shape[1]:
        raise InputError(UNDETERMINED)
    full = solution / scale
    turn = nearest_rotations(full[:9].reshape(3, 3))
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
        raise InputError(UNDETERMINED)
    variance = 2 * float(fit.cost) / (spheres.size - fit.x.size)
    matrix = start @ rigid(exponential(fit.x[:3]), fit.x[3:6])
    covariance = carried(matrix, np.linalg.inv(information)[:6, :6] * variance)
    rms = float(np.sqrt(2 * fit.cost / len(spheres)))
    return TcpCalibration(Pose(matrix, covariance, TCP, RIG), fit.x[6:], rms, float(np.sqrt(variance)))
