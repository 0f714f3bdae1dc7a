"""registration.json: which CT marker is which reading, the transform, and the error to expect at the targets."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Literal, Self

import numpy as np
from pydantic import model_validator

from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.ct.identity import ScanIdentity
from ronnaplan.ct.volume import CTVolume, ScalarMap
from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.fields import (
    Covariance,
    DocumentModel,
    EndLabel,
    Label,
    LengthMm,
    Line,
    Matrix4,
    Nats,
    PoseCovariance,
    Probability,
    Revision,
    Software,
    Vector,
    flag_sentence,
    told_by_reader,
)
from ronnaplan.documents.reading import read_document
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame, Points, rms_mm
from ronnaplan.planning.uncertainty import ExpectedPose
from ronnaplan.pose import Pose, as_pose
from ronnaplan.registration.flags import RegistrationFlag
from ronnaplan.registration.maps import error_map
from ronnaplan.sigmas import SIGMA_OTS_MM
from ronnaplan.tracking.recording import OTS
from ronnaplan.transforms import transform_points

FORMAT = "ronnaplan.registration"
SAME_ERROR = 1e-6
"""Relative round-off between an expected error and the covariance that it is taken from."""
SAME_RESIDUAL_MM = 1e-6
"""Round-off between a residual and the transform and places that it is taken from."""


class LabelPair(DocumentModel):
    """One CT marker and the reading it was taken for."""

    ct: Label
    ots: Label


class PairEntry(LabelPair):
    """One pair of the registration, mm: its residual, and its distance from what all other pairs predict."""

    residual: LengthMm
    leave_one_out: LengthMm | None = None
    center: Vector
    reading: Vector


class RivalEntry(DocumentModel):
    """Another pairing, and how far behind it lies."""

    pairs: tuple[LabelPair, ...]
    log_evidence_below: Nats


class TargetEntry(DocumentModel):
    """A place in the scan and the registration's expected error there (mm; covariance in the tracker's axes)."""

    name: EndLabel
    center: Vector
    predicted_tre_rms: LengthMm
    covariance: Covariance

    @model_validator(mode="after")
    def _check(self) -> Self:
        rms = float(rms_mm(np.array(self.covariance)))
        if not np.isclose(self.predicted_tre_rms, rms, rtol=SAME_ERROR, atol=0.0):
            raise ValueError(
                f"predicted_tre_rms is {self.predicted_tre_rms:g} mm, but its covariance says {rms:g} mm"
            )
        return self


class Frames(DocumentModel):
    """The frames that the transform joins."""

    ct: Label = "CT"
    ots: Label = "OTS"


class RegistrationDocument(DocumentModel):
    """The whole of registration.json, version 1. Without a unique pairing there is no transform."""

    format: Literal["ronnaplan.registration"]
    version: Literal[1]
    unit: Literal["mm"]
    revision: Revision = 0
    status: Literal["unique", "ambiguous", "unmatched"]
    reason: Line = ""
    source: Source = Source()
    frames: Frames = Frames()
    pairs: tuple[PairEntry, ...] = ()
    unpaired_ct: tuple[Label, ...] = ()
    unpaired_ots: tuple[Label, ...] = ()
    probability: Probability | None = None
    rivals: tuple[RivalEntry, ...] = ()
    ots_from_ct: Matrix4 | None = None
    covariance: PoseCovariance | None = None
    fre_rms: LengthMm | None = None
    sigma_ct_mm: LengthMm | None = None
    sigma_ots_mm: LengthMm | None = None
    fit_probability: Probability | None = None
    flags: tuple[Line, ...] = ()
    doubt: Line | None = None
    targets: tuple[TargetEntry, ...] = ()
    notes: tuple[Line, ...] = ()
    """What was to be told of the readings and of markers left out when it was made, a sentence each."""
    software: Software

    @model_validator(mode="after")
    def _check(self) -> RegistrationDocument:
        if self.status == "unique" and (self.ots_from_ct is None or self.covariance is None):
            raise ValueError("a unique registration lacks ots_from_ct or its covariance")
        if self.status == "unique":
            _check_pairs(self.pairs)
            _check_left_out(self)
        elif self.ots_from_ct is not None or self.covariance is not None:
            raise ValueError(f"the registration is {self.status}, yet holds ots_from_ct or a covariance")
        if self.ots_from_ct is not None:
            with told_by_reader():
                as_pose(self.ots_from_ct, "ots_from_ct")
        if self.status == "unique":
            _check_residuals(self)
            _check_targets(self)
        return self

    def __repr__(self) -> str:
        if self.status != "unique":
            return f"RegistrationDocument({self.status}: {self.reason}; {len(self.rivals)} rivals)"
        fre = "" if self.fre_rms is None else f", FRE {self.fre_rms:.3g} mm"
        flags = "".join(f", {flag}" for flag in self.flags)
        return f"RegistrationDocument(unique, {len(self.pairs)} pairs{fre}, {len(self.targets)} targets{flags})"

    __str__ = __repr__

    @property
    def ct_frame(self) -> Frame:
        """The scan's frame of reference."""
        return Frame(self.frames.ct, self.source.frame_of_reference_uid)

    @property
    def identity(self) -> ScanIdentity:
        """The scan that it belongs to."""
        return self.source.identity("the registration", self.ct_frame)

    @property
    def pose(self) -> Pose:
        """``ots_from_ct`` with its covariance; raises `InputError` for a registration that was refused."""
        self.require_unique()
        assert self.ots_from_ct is not None
        matrix = as_pose(self.ots_from_ct, "ots_from_ct")
        return Pose(matrix, np.array(self.covariance), Frame(self.frames.ots), self.ct_frame)

    @property
    def expected(self) -> ExpectedPose:
        """The error to expect of this registration; raises `InputError` where it was refused."""
        markers = tuple(pair.ct for pair in self.pairs)
        return ExpectedPose.registered(self.pose, markers, self.sigma_ct_mm, self.sigma_ots_mm)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the registration should be doubted, a sentence each."""
        flags = (flag_sentence(RegistrationFlag, flag) for flag in self.flags)
        sides = (("CT markers", self.unpaired_ct), ("readings", self.unpaired_ots))
        alone = (f"{what} without a partner: {', '.join(labels)}" for what, labels in sides if labels)
        return (*flags, *([self.doubt] if self.doubt else []), *(alone if self.status == "unique" else ()))

    @property
    def readings(self) -> Points:
        """The paired readings, labelled like their CT markers, with the mean error that the registration gave them.

        Raises `InputError` for a registration that was refused.
        """
        self.require_unique()
        count = len(self.pairs)
        sigma_mm = SIGMA_OTS_MM if self.sigma_ots_mm is None else self.sigma_ots_mm
        return Points(
            np.array([pair.reading for pair in self.pairs], dtype=np.float64).reshape(count, 3),
            np.tile(sigma_mm**2 * np.eye(3), (count, 1, 1)),
            tuple(pair.ct for pair in self.pairs),
            Frame(self.frames.ots),
        )

    def require_unique(self) -> None:
        """Raise `InputError` for a registration that was refused: it has no pairs, and no transform."""
        if self.status != "unique" or self.ots_from_ct is None or self.covariance is None:
            raise InputError(f"this registration was refused ({self.status}: {self.reason}); register again")

    def require_frame(self, frame: Frame) -> None:
        """Raise `FrameMismatchError` unless this registration is of the scan ``frame``."""
        self.ct_frame.require(frame)

    def require_tracker(self) -> None:
        """Raise `FrameMismatchError` unless the readings are in the tracker's own frame, as poses of its tools are."""
        if self.frames.ots != OTS.name:
            raise FrameMismatchError(
                f"the registration's readings are in the frame {self.frames.ots}, and poses of tools in the tracker's "
                f"own, {OTS}; register readings that the tracker itself has written (what Slicer saves is in LPS, "
                "where x and y have the other sign)"
            )

    def tre_map(self, volume: CTVolume) -> ScalarMap:
        """Return the expected root-mean-square TRE (mm) at every voxel of the scan that was registered.

        Raises what `ScanIdentity.require` does for another scan, and `InputError` for a registration that was refused.
        """
        pose = self.pose
        volume.identity.require(self.identity)
        return error_map(pose, volume, pose.from_frame)


def read_registration(path: str | os.PathLike[str]) -> RegistrationDocument:
    """Read and check registration.json; raises `InputError` naming the first field that is wrong."""
    return read_document(
        path, RegistrationDocument, kind="registration document", remedy="write it anew with register"
    )


def _check_pairs(pairs: Sequence[LabelPair]) -> None:
    if len(pairs) < LEAST_PAIRS:
        raise ValueError(f"a unique registration holds {len(pairs)} pairs; expected {LEAST_PAIRS} or more")
    for labels in ([pair.ct for pair in pairs], [pair.ots for pair in pairs]):
        if len(set(labels)) < len(labels):
            raise ValueError(f"the pairs name the markers {', '.join(labels)}; expected each once")


def _check_left_out(document: RegistrationDocument) -> None:
    """Raise where a marker or reading of a pair is said to have no partner, too."""
    sides = (("ct", document.unpaired_ct), ("ots", document.unpaired_ots))
    for side, unpaired in sides:
        both = {getattr(pair, side) for pair in document.pairs}.intersection(unpaired)
        if both:
            raise ValueError(f"{min(both)} is in a pair, and in unpaired_{side}, too; expected one of the two")


def _check_residuals(document: RegistrationDocument) -> None:
    """Raise unless the residuals, and their root mean square, are those of the transform and the pairs' places."""
    centers, readings = (
        np.array([getattr(pair, which) for pair in document.pairs]) for which in ("center", "reading")
    )
    residuals_mm = np.linalg.norm(readings - transform_points(document.pose.matrix, centers), axis=1)
    for pair, length_mm in zip(document.pairs, residuals_mm.tolist(), strict=True):
        if abs(pair.residual - length_mm) > SAME_RESIDUAL_MM:
            raise ValueError(
                f"the residual of {pair.ct} is {pair.residual:.9g} mm, but ots_from_ct leaves {length_mm:.9g} mm"
            )
    rms_mm = float(np.sqrt(np.mean(residuals_mm**2)))
    if document.fre_rms is not None and abs(document.fre_rms - rms_mm) > SAME_RESIDUAL_MM:
        raise ValueError(f"fre_rms is {document.fre_rms:.9g} mm, but the residuals have {rms_mm:.9g} mm")


def _check_targets(document: RegistrationDocument) -> None:
    """Raise unless each target's covariance is that of the transform at its place."""
    if not document.targets:
        return
    covariances = document.pose.point_covariances(np.array([target.center for target in document.targets]))
    for target, covariance in zip(document.targets, covariances, strict=True):
        if np.abs(covariance - np.array(target.covariance)).max() > SAME_ERROR * np.trace(covariance):
            raise ValueError(f"the covariance of {target.name} is not that of the transform at its place")
