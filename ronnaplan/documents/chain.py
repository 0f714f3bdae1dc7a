"""chain.json: the scan in the robot's coordinates, by which way, and what each link of the way adds to the error."""

from __future__ import annotations

import os
from typing import Any, Literal, Self

from pydantic import model_validator

from ronnaplan.ct.identity import ScanIdentity
from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.fields import (
    DocumentModel,
    Label,
    LengthMm,
    Line,
    Probability,
    Revision,
    Software,
    Vector,
)
from ronnaplan.documents.poses import PoseEntry, pose_entry, same_pose
from ronnaplan.documents.reading import made, read_document
from ronnaplan.geometry import FloatArray, Frame, rms_mm
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import OTS, TCP, Capture, M, R, robot_from_ct
from ronnaplan.robot.stereo.markers import RobotRegistration

LINKS = ("registration", "tracked tool", "tool calibration", "robot")


class Links(DocumentModel):
    """The way by the tracker: Eq. 4, 6, 7 and 3."""

    ots_from_ct: PoseEntry
    ots_from_m: PoseEntry
    m_from_tcp: PoseEntry
    robot_from_tcp: PoseEntry

    @property
    def capture(self) -> Capture:
        """The moment at which tracker and robot were read."""
        return Capture(
            self.ots_from_m.pose(OTS, M), self.m_from_tcp.pose(M, TCP), self.robot_from_tcp.pose(R, TCP)
        )


class SpherePair(DocumentModel):
    """A marker of the scan, the sphere that it is in R, and how far they are apart."""

    ct: Label
    sphere: Label
    residual: LengthMm


class Share(DocumentModel):
    """RMS error (mm) that one link alone brings at the middle of the markers."""

    link: Line
    rms: LengthMm


class ChainDocument(DocumentModel):
    """The whole of chain.json, version 1."""

    format: Literal["ronnaplan.chain"]
    version: Literal[1]
    unit: Literal["mm"]
    revision: Revision = 0
    way: Literal["tracker", "stereo"]
    source: Source
    robot_from_ct: PoseEntry
    links: Links | None = None
    pairs: tuple[SpherePair, ...] = ()
    middle: Vector
    """Of the markers, LPS: where the shares are stated."""
    shares: tuple[Share, ...]
    fit_probability: Probability | None = None
    """Of the stereo way: chance that errors as stated leave residuals as large."""
    notes: tuple[Line, ...] = ()
    software: Software

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.links is None) == (self.way == "tracker"):
            raise ValueError(f"links belong to the way by the tracker, but the way is '{self.way}'")
        if self.links is not None:
            through = robot_from_ct(self.links.ots_from_ct.pose(OTS, self.ct_frame), self.links.capture)
            if not same_pose(through, self.pose):
                raise ValueError("robot_from_ct is not the product of the links")
        return self

    @property
    def ct_frame(self) -> Frame:
        """The scan's frame of reference."""
        return self.source.frame

    @property
    def identity(self) -> ScanIdentity:
        """The scan that it belongs to."""
        return self.source.identity("the chain", self.ct_frame)

    @property
    def pose(self) -> Pose:
        """R from CT with the errors of all links."""
        return self.robot_from_ct.pose(R, self.ct_frame)


def tracked_chain(
    ots_from_ct: Pose, capture: Capture, source: Source, middle_mm: FloatArray, notes: tuple[str, ...] = ()
) -> ChainDocument:
    """Return the document of the way by the tracker; ``middle_mm`` (3,) is that of the markers."""
    poses = (ots_from_ct, capture.ots_from_m, capture.m_from_tcp, capture.robot_from_tcp)
    alone = []
    for erring in poses:
        first, seen, tool, robot = (pose if pose is erring else _exact(pose) for pose in poses)
        alone.append(robot_from_ct(first, Capture(seen, tool, robot)))
    return _document(
        {
            "way": "tracker",
            "robot_from_ct": pose_entry(robot_from_ct(ots_from_ct, capture)),
            "links": {
                "ots_from_ct": pose_entry(ots_from_ct),
                "ots_from_m": pose_entry(capture.ots_from_m),
                "m_from_tcp": pose_entry(capture.m_from_tcp),
                "robot_from_tcp": pose_entry(capture.robot_from_tcp),
            },
            "shares": [_share(name, pose, middle_mm) for name, pose in zip(LINKS, alone, strict=True)],
        },
        source,
        middle_mm,
        notes,
    )


def stereo_chain(
    found: RobotRegistration, source: Source, middle_mm: FloatArray, notes: tuple[str, ...] = ()
) -> ChainDocument:
    """Return the document of the final registration, to re-localized markers; ``middle_mm`` (3,) is theirs in CT."""
    return _document(
        {
            "way": "stereo",
            "robot_from_ct": pose_entry(found.robot_from_ct),
            "pairs": [
                {"ct": ct, "sphere": sphere, "residual": residual}
                for (ct, sphere), residual in zip(
                    found.labels, found.registration.residuals_mm.tolist(), strict=True
                )
            ],
            "shares": [_share("registration and cameras", found.robot_from_ct, middle_mm)],
            "fit_probability": found.registration.fit_probability,
        },
        source,
        middle_mm,
        notes,
    )


def read_chain(path: str | os.PathLike[str]) -> ChainDocument:
    """Read and check chain.json; raises `InputError` naming the first field that is wrong."""
    return read_document(path, ChainDocument, kind="chain", remedy="write it anew with 'robot chain'")


def _document(
    content: dict[str, Any], source: Source, middle_mm: FloatArray, notes: tuple[str, ...]
) -> ChainDocument:
    always = {
        "notes": notes,
        "source": source.model_dump(),
        "middle": middle_mm.tolist(),
    }
    return made(ChainDocument, always | content)


def _exact(pose: Pose) -> Pose:
    return Pose.exact(pose.matrix, pose.to_frame, pose.from_frame)


def _share(link: str, pose: Pose, place_mm: FloatArray) -> dict[str, object]:
    return {"link": link, "rms": float(rms_mm(pose.point_covariances(place_mm[None])[0]))}
