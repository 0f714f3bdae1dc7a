"""rig.json and spheres.json: the calibrated cameras on the robot, and the markers that they found again."""

from __future__ import annotations

import os
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ronnaplan.documents.fields import (
    DocumentModel,
    Label,
    LengthMm,
    Line,
    MarkerCovariance,
    Matrix4,
    PositiveMm,
    Probability,
    Ratio,
    Revision,
    Software,
    Vector,
    require_different_names,
    told_by_reader,
)
from ronnaplan.documents.poses import SAME_POSE_MM, PoseEntry, pose_entry
from ronnaplan.documents.reading import made, read_document
from ronnaplan.pose import as_pose
from ronnaplan.robot.chain import TCP
from ronnaplan.robot.stereo.board import FEWEST_BOARDS, FEWEST_CORNERS, MOST_CORNERS
from ronnaplan.robot.stereo.calibration import StereoCalibration, TcpCalibration
from ronnaplan.robot.stereo.camera import RIG, Boards, Camera, StereoRig
from ronnaplan.robot.stereo.robot_markers import RobotMarkers

LARGEST_LENS = 1e6
"""No camera has so many pixels, and no lens such a distortion."""
LensNumber = Annotated[float, Field(ge=-LARGEST_LENS, le=LARGEST_LENS)]
Pixels = Annotated[int, Field(ge=1, le=1 << 16)]
PositivePixels = Annotated[float, Field(gt=0, le=LARGEST_LENS)]
MOST_BOARDS = 10_000
"""Pairs of images: some dozen calibrate cameras."""
Corners = Annotated[int, Field(ge=FEWEST_CORNERS, le=MOST_CORNERS)]
LensRow = tuple[LensNumber, LensNumber, LensNumber]
Distortion = tuple[LensNumber, LensNumber, LensNumber, LensNumber, LensNumber]


class CameraEntry(DocumentModel):
    """One camera in OpenCV's model: pixels, and mm of the rig."""

    matrix: tuple[LensRow, LensRow, LensRow]
    distortion: Distortion
    """k1, k2, p1, p2, k3."""
    rig_from_camera: Matrix4
    size: tuple[Pixels, Pixels] | None = None
    """Columns and rows of its images; not told by versions up to 0.2."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        with told_by_reader():
            self.camera()
        return self

    def camera(self) -> Camera:
        """Return the camera."""
        place = as_pose(self.rig_from_camera, "rig_from_camera")
        return Camera(np.array(self.matrix), np.array(self.distortion), place, self.size)


class BoardsEntry(DocumentModel):
    """The boards that the cameras were calibrated on: from where they were follows how well the cameras are known."""

    corners: tuple[Corners, Corners]
    """Columns and rows of inner corners."""
    square: PositiveMm
    """Side of the squares."""
    rig_from_board: tuple[Matrix4, ...] = Field(min_length=FEWEST_BOARDS, max_length=MOST_BOARDS)
    """Each board's first corner is at its origin."""
    error_px: PositivePixels
    """Standard deviation per axis of a corner's place in an image."""
    lens_px: Ratio
    """By so much (RMS per axis) the lenses may bend otherwise than the cameras' model has it."""
    sigma_square: Probability
    """Standard error of the squares' side, as a part of it."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        with told_by_reader():
            self.boards()
        return self

    def boards(self) -> Boards:
        """Return the boards."""
        places = np.array([as_pose(place, "rig_from_board") for place in self.rig_from_board])
        return Boards(self.corners, self.square, places, self.error_px, self.lens_px, self.sigma_square)


class RigDocument(DocumentModel):
    """The whole of rig.json, version 1."""

    format: Literal["ronnaplan.rig"]
    version: Literal[1]
    unit: Literal["mm"]
    revision: Revision = 0
    left: CameraEntry
    right: CameraEntry
    rms_px: Ratio
    """RMS distance of the board's corners from their places."""
    boards: Annotated[int, Field(ge=1)]
    tcp_from_rig: PoseEntry
    scatter: LengthMm
    """Standard deviation per axis of one look's place of the resting sphere."""
    looks: Annotated[int, Field(ge=1)]
    diameter_mm: PositiveMm
    """Of the resting sphere."""
    calibrated_on: BoardsEntry | None = None
    """Not told by versions up to 0.2, whose cameras are taken for true."""
    notes: tuple[Line, ...] = ()
    software: Software

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.calibrated_on is not None and len(self.calibrated_on.rig_from_board) != self.boards:
            raise ValueError(
                f"tells of {self.boards} boards, but where {len(self.calibrated_on.rig_from_board)} of them were"
            )
        with told_by_reader():
            _ = self.rig
        return self

    @property
    def rig(self) -> StereoRig:
        """The cameras on the robot."""
        boards = None if self.calibrated_on is None else self.calibrated_on.boards()
        return StereoRig(self.left.camera(), self.right.camera(), self.tcp_from_rig.pose(TCP, RIG), boards)


class SphereEntry(DocumentModel):
    """One sphere: in R, and in the rig from the robot's pose at that look."""

    label: Label
    position: Vector
    covariance: MarkerCovariance
    """In R, of the errors that this look has for itself: outlines, cameras, robot."""
    in_rig: Vector
    robot_from_tcp: Matrix4


class SpheresDocument(DocumentModel):
    """The whole of spheres.json, version 1."""

    format: Literal["ronnaplan.spheres"]
    version: Literal[1]
    unit: Literal["mm"]
    revision: Revision = 0
    diameter_mm: PositiveMm
    tcp_from_rig: PoseEntry
    """Its error is common to all spheres, and not in their covariances."""
    spheres: tuple[SphereEntry, ...] = Field(min_length=1)
    notes: tuple[Line, ...] = ()
    software: Software

    @model_validator(mode="after")
    def _check(self) -> Self:
        require_different_names("spheres", [one.label for one in self.spheres])
        with told_by_reader():
            places = self.markers.positions_mm
        for one, place in zip(self.spheres, places, strict=True):
            if not np.allclose(one.position, place, rtol=0.0, atol=SAME_POSE_MM):
                raise ValueError(f"sphere {one.label} is not where its look puts it")
        return self

    @property
    def markers(self) -> RobotMarkers:
        """The spheres with their own and their common errors."""
        return RobotMarkers(
            tuple(one.label for one in self.spheres),
            np.array([one.in_rig for one in self.spheres], dtype=np.float64),
            np.array([one.covariance for one in self.spheres], dtype=np.float64),
            np.array([as_pose(one.robot_from_tcp, f"robot_from_tcp of {one.label}") for one in self.spheres]),
            self.tcp_from_rig.pose(TCP, RIG),
        )


def rig_document(
    cameras: StereoCalibration, tcp: TcpCalibration, looks: int, diameter_mm: float, notes: tuple[str, ...] = ()
) -> RigDocument:
    """Turn the two calibrations of a rig into its document."""
    return made(
        RigDocument,
        {
            "notes": notes,
            "left": _camera(cameras.left),
            "right": _camera(cameras.right),
            "rms_px": cameras.rms_px,
            "boards": cameras.boards_used,
            "calibrated_on": {
                "corners": cameras.boards.corners,
                "square": cameras.boards.square_mm,
                "rig_from_board": cameras.boards.rig_from_board.tolist(),
                "error_px": cameras.boards.error_px,
                "lens_px": cameras.boards.lens_px,
                "sigma_square": cameras.boards.sigma_square,
            },
            "tcp_from_rig": pose_entry(tcp.tcp_from_rig),
            "scatter": tcp.sd_mm,
            "looks": looks,
            "diameter_mm": diameter_mm,
        },
    )


def read_rig(path: str | os.PathLike[str]) -> RigDocument:
    """Read and check rig.json; raises `InputError` naming the first field that is wrong."""
    return read_document(
        path, RigDocument, kind="camera calibration", remedy="write it anew with 'robot stereo-calibrate'"
    )


def spheres_document(found: RobotMarkers, diameter_mm: float, notes: tuple[str, ...] = ()) -> SpheresDocument:
    """Turn re-localized markers into their document."""
    return made(
        SpheresDocument,
        {
            "notes": notes,
            "diameter_mm": diameter_mm,
            "tcp_from_rig": pose_entry(found.tcp_from_rig),
            "spheres": [
                {
                    "label": label,
                    "position": found.positions_mm[k].tolist(),
                    "covariance": found.own_mm2[k].tolist(),
                    "in_rig": found.in_rig_mm[k].tolist(),
                    "robot_from_tcp": found.robot_from_tcp[k].tolist(),
                }
                for k, label in enumerate(found.labels)
            ],
        },
    )


def read_spheres(path: str | os.PathLike[str]) -> SpheresDocument:
    """Read and check spheres.json; raises `InputError` naming the first field that is wrong."""
    return read_document(
        path, SpheresDocument, kind="set of re-localized spheres", remedy="write it anew with 'robot relocate'"
    )


def _camera(camera: Camera) -> dict[str, object]:
    return {
        "matrix": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
        "rig_from_camera": camera.rig_from_camera.tolist(),
        "size": camera.size_px,
    }
