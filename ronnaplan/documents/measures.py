"""The fields of measures.json, for its schema: what `ronnaplan.documents.plan_measures` writes, and nobody reads here.

What cannot be told of a trajectory (a surface that it does not meet, a value outside the scan) is null.
"""

from __future__ import annotations

from typing import Literal

from pydantic import FiniteFloat

from ronnaplan.documents.fields import DocumentModel, Label, LengthMm, Line, Matrix3, Probability, Row3, Software

Measured = FiniteFloat | None
Place = tuple[Measured, Measured, Measured]
"""LPS mm."""


class SourceEntry(DocumentModel):
    """The scan that the plan is of."""

    frame_of_reference_uid: Line | None
    voxel_sha256: Line | None


class SurfaceEntry(DocumentModel):
    """Where the path meets a surface; ``standard_error_mm`` is along the path, ``clear`` whether its edge is."""

    position: Place
    normal: Place
    standard_error_mm: Measured
    clear: bool


class ProfileEntry(DocumentModel):
    """Values along the path from the entry to the target."""

    depth_mm: tuple[FiniteFloat, ...]
    hu: tuple[Measured, ...]


class ClearanceEntry(DocumentModel):
    """The least distance to an obstacle: from the axis, from the instrument, where, and what of it is sure."""

    kind: Literal["no-go", "metal", "marker"]
    name: Line
    distance_mm: Measured
    clearance_mm: Measured
    depth_mm: Measured
    at_least_mm: Measured
    smooth: bool


class ContactEntry(DocumentModel):
    """A contact of an electrode, the deepest first; ``inside`` is null where the inner table is not known."""

    number: int
    center: Row3
    depth_mm: FiniteFloat
    inside: bool | None
    clearances: tuple[ClearanceEntry, ...]


class ElectrodeEntry(DocumentModel):
    """An electrode and its contacts."""

    model: Line
    contacts: tuple[ContactEntry, ...]


class SpacingEntry(DocumentModel):
    """The least distance to another trajectory: between axes, between instruments, and where."""

    other: Label
    distance_mm: Measured
    clearance_mm: Measured
    depth_mm: Measured


class ArcEntry(DocumentModel):
    """Settings of a Leksell-style frame."""

    arc_deg: Measured
    ring_deg: Measured


class AcPcEntry(DocumentModel):
    """The path in the AC-PC frame; ``target_mm`` is right, anterior, superior of the mid-commissural point."""

    sagittal_deg: Measured
    coronal_deg: Measured
    target_mm: Place


class ErrorEntry(DocumentModel):
    """The error to expect along the path, at each depth from the entry; the last is the target's."""

    basis: Literal["registered", "planned"]
    markers: tuple[Label, ...]
    sigma_ct_mm: LengthMm | None
    sigma_ots_mm: LengthMm | None
    depth_mm: tuple[FiniteFloat, ...]
    tre_rms_mm: tuple[FiniteFloat, ...]
    tube_radius_mm: tuple[FiniteFloat, ...]
    covariances_mm2: tuple[Matrix3, ...]
    angular_rms_deg: Measured
    tolerance_mm: LengthMm
    probability: Probability


class TrajectoryEntry(DocumentModel):
    """A trajectory, measured."""

    name: Label
    length_mm: LengthMm
    depth_below_scalp_mm: Measured
    depth_below_skull_mm: Measured
    entry_below_scalp_mm: Measured
    skull_thickness_mm: Measured
    skull_angle_deg: Measured
    scalp_angle_deg: Measured
    doubts: tuple[Line, ...]
    way_out: Literal["open", "cut", "covered"]
    scalp: SurfaceEntry | None
    outer_table: SurfaceEntry | None
    inner_table: SurfaceEntry | None
    profile: ProfileEntry
    clearances: tuple[ClearanceEntry, ...]
    electrode: ElectrodeEntry | None
    spacings: tuple[SpacingEntry, ...]
    arc_and_ring: ArcEntry
    ac_pc: AcPcEntry | None
    expected_error: ErrorEntry | None
    planned_error: ErrorEntry | None


class VerdictEntry(DocumentModel):
    """One measure against its limit, if it has one."""

    trajectory: Label
    measure: Line
    value: Measured
    unit: Line
    limit: Measured
    passes: bool
    remark: Line


class MeasuresDocument(DocumentModel):
    """The whole of measures.json, version 1."""

    format: Literal["ronnaplan.measures"]
    version: Literal[1]
    coordinate_system: Literal["LPS"]
    unit: Literal["mm"]
    source: SourceEntry
    trajectories: tuple[TrajectoryEntry, ...]
    verdicts: tuple[VerdictEntry, ...]
    software: Software
