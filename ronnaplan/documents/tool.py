"""pivot.json and hand-eye.json: where the robot's TCP is on the tool that the tracker sees."""

from __future__ import annotations

import os
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ronnaplan.documents.fields import (
    Covariance,
    DocumentModel,
    Label,
    LengthMm,
    Line,
    Ratio,
    Revision,
    Software,
    Vector,
)
from ronnaplan.documents.poses import PoseEntry, pose_entry
from ronnaplan.documents.reading import made, read_document
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import OTS, TCP, M, R
from ronnaplan.robot.hand_eye_found import HandEye
from ronnaplan.robot.pivot import PivotCalibration

Count = Annotated[int, Field(ge=0)]


class PivotDocument(DocumentModel):
    """The whole of pivot.json, version 1: the tip in the tool's frame M, mm."""

    format: Literal["ronnaplan.pivot"]
    version: Literal[1]
    unit: Literal["mm"]
    revision: Revision = 0
    tool: Label
    tip: Vector
    covariance: Covariance
    pivot: Vector
    """Where the tip rested, in the tracker's frame."""
    pivot_covariance: Covariance
    rms: LengthMm
    """RMS distance of the tip from the pivot over the poses that were used."""
    poses: Count
    slipped: tuple[tuple[Count, Count], ...] = ()
    """First and last of each run of poses that were left out, counted from 0 among those that could be used."""
    notes: tuple[Line, ...] = ()
    software: Software

    @property
    def tip_mm(self) -> FloatArray:
        """The tip (3,) in M."""
        return np.array(self.tip)

    @property
    def tip_covariance_mm2(self) -> FloatArray:
        """Its covariance (3, 3)."""
        return np.array(self.covariance)


class HandEyeDocument(DocumentModel):
    """The whole of hand-eye.json, version 1."""

    format: Literal["ronnaplan.hand-eye"]
    version: Literal[1]
    unit: Literal["mm"]
    revision: Revision = 0
    tool: Label
    m_from_tcp: PoseEntry
    robot_from_ots: PoseEntry
    """While it was recorded; another one as soon as the tracker or the robot's trolley is moved."""
    rotation_rms_deg: Ratio
    translation_rms: LengthMm
    poses: Count
    pivot: bool
    """Whether a pivot calibration's tip is in it."""
    notes: tuple[Line, ...] = ()
    software: Software

    @property
    def tcp_in_m(self) -> Pose:
        """M from TCP."""
        return self.m_from_tcp.pose(M, TCP)

    @property
    def tracker_in_r(self) -> Pose:
        """R from OTS while it was recorded."""
        return self.robot_from_ots.pose(R, OTS)


def pivot_document(found: PivotCalibration, tool: str, notes: tuple[str, ...] = ()) -> PivotDocument:
    """Turn a pivot calibration into its document."""
    return made(
        PivotDocument,
        {
            "tool": tool,
            "notes": notes,
            "tip": found.tip_mm.tolist(),
            "covariance": found.tip_covariance_mm2.tolist(),
            "pivot": found.pivot_mm.tolist(),
            "pivot_covariance": found.pivot_covariance_mm2.tolist(),
            "rms": found.rms_mm,
            "poses": len(found.residuals_mm),
            "slipped": found.slips,
        },
    )


def read_pivot(path: str | os.PathLike[str]) -> PivotDocument:
    """Read and check pivot.json; raises `InputError` naming the first field that is wrong."""
    return read_document(path, PivotDocument, kind="pivot calibration", remedy="write it anew with 'robot pivot'")


def hand_eye_document(
    found: HandEye, tool: str, poses: int, *, pivot: bool, notes: tuple[str, ...] = ()
) -> HandEyeDocument:
    """Turn a hand-eye calibration into its document."""
    return made(
        HandEyeDocument,
        {
            "tool": tool,
            "poses": poses,
            "pivot": pivot,
            "m_from_tcp": pose_entry(found.m_from_tcp),
            "robot_from_ots": pose_entry(found.robot_from_ots),
            "rotation_rms_deg": found.rotation_rms_deg,
            "translation_rms": found.translation_rms_mm,
            "notes": notes,
        },
    )


def read_hand_eye(path: str | os.PathLike[str]) -> HandEyeDocument:
    """Read and check hand-eye.json; raises `InputError` naming the first field that is wrong."""
    return read_document(
        path, HandEyeDocument, kind="hand-eye calibration", remedy="write it anew with 'robot hand-eye'"
    )
