"""plan.json: trajectories in one scan's frame of reference, with every change that led to them."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ronnaplan.ct.volume import SeriesSource
from ronnaplan.documents.fields import (
    DocumentModel,
    Label,
    Line,
    Notes,
    PositiveMm,
    Revision,
    Software,
    Time,
    Vector,
)
from ronnaplan.documents.files import change_document, write_atomically
from ronnaplan.documents.reading import made, read_document, to_json
from ronnaplan.errors import InputError, RonnaplanError, check_type
from ronnaplan.geometry import FloatArray, Frame
from ronnaplan.planning.changes import Change, Item
from ronnaplan.planning.electrodes import electrode_named
from ronnaplan.planning.landmarks import Landmarks
from ronnaplan.planning.plan import Plan
from ronnaplan.planning.rulers import Ruler
from ronnaplan.planning.trajectory import Instrument, Trajectory

FORMAT = "ronnaplan.plan"


class InstrumentEntry(DocumentModel):
    """What goes along a path."""

    name: Label
    diameter_mm: PositiveMm
    length_mm: PositiveMm


class TrajectoryEntry(DocumentModel):
    """One trajectory; points in LPS mm."""

    name: Label
    entry: Vector
    target: Vector
    instrument: InstrumentEntry
    colour: Annotated[str, Field(pattern=r"^#[0-9a-f]{6}$")]
    locked: bool = False
    notes: Notes = ""
    electrode: Label | None = None


class LandmarksEntry(DocumentModel):
    """AC, PC and a point of the midline, LPS mm."""

    ac: Vector
    pc: Vector
    midline: Vector


class RulerEntry(DocumentModel):
    """A distance between two points, or the angle at the second of three, LPS mm."""

    name: Label
    points: Annotated[tuple[Vector, ...], Field(min_length=2, max_length=3)]


ItemEntry = TrajectoryEntry | LandmarksEntry | RulerEntry


class ChangeEntry(DocumentModel):
    """One step of the history."""

    time: Time
    action: Line
    index: Annotated[int, Field(ge=0)]
    before: ItemEntry | None
    after: ItemEntry | None


class PlanSource(DocumentModel):
    """The scan that the plan is tied to; nothing here names the patient."""

    study_instance_uid: Line | None = None
    series_instance_uid: Line | None = None
    frame_of_reference_uid: Line | None = None
    voxel_sha256: Line | None = None


class PlanDocument(DocumentModel):
    """The whole of plan.json, version 1."""

    format: Literal["ronnaplan.plan"]
    version: Literal[1]
    coordinate_system: Literal["LPS"]
    unit: Literal["mm"]
    revision: Revision = 0
    source: PlanSource
    landmarks: LandmarksEntry | None = None
    trajectories: tuple[TrajectoryEntry, ...]
    history: tuple[ChangeEntry, ...] = ()
    undone: tuple[ChangeEntry, ...] = ()
    measurements: tuple[RulerEntry, ...] = ()
    software: Software


def plan_document(plan: Plan) -> PlanDocument:
    """Turn a plan into its document."""
    return made(
        PlanDocument,
        {
            "revision": plan.revision,
            "source": {**plan.source.uids, "voxel_sha256": plan.voxel_sha256},
            "landmarks": _entry(plan.landmarks),
            "trajectories": [_entry(one) for one in plan.trajectories],
            "history": [_change_entry(change) for change in plan.history],
            "undone": [_change_entry(change) for change in plan.undone],
            "measurements": [_entry(one) for one in plan.rulers],
        },
    )


def write_plan(path: str | os.PathLike[str], plan: Plan) -> None:
    """Write plan.json, whole or not at all, whatever was there; raises `InputError` where that fails."""
    check_type(plan, Plan, "the plan", "Plan.of_scan(volume) begins one, read_plan reads one")
    write_atomically(path, plan_text(plan))


def change_plan(path: str | os.PathLike[str], change: Callable[[Plan], Plan]) -> Plan:
    """Make a change to plan.json as it is now, while nobody else writes it; returns the plan as written.

    ``change`` is given the plan that is there. What it raises leaves the file as it was.
    """
    return change_document(path, read_plan, change, plan_text)


def read_plan(path: str | os.PathLike[str]) -> Plan:
    """Read and check plan.json; raises `InputError` naming the first field that is wrong, or a newer version."""
    document = read_document(path, PlanDocument, kind="plan", remedy="correct it or start a new plan")
    try:
        return _plan(document)
    except RonnaplanError as error:
        raise InputError(f"{os.fspath(path)}: {error}") from error


def plan_text(plan: Plan) -> str:
    """Return plan.json's text."""
    return to_json(plan_document(plan))


def _plan(document: PlanDocument) -> Plan:
    given = document.source
    source = SeriesSource(given.study_instance_uid, given.series_instance_uid, given.frame_of_reference_uid)
    trajectories = tuple(_trajectory(entry, source.frame) for entry in document.trajectories)
    names = [one.name for one in trajectories]
    if len(set(names)) != len(names):
        raise InputError("two trajectories have the same name; rename one")
    rulers = tuple(map(_ruler, document.measurements))
    if len({one.name for one in rulers}) != len(rulers):
        raise InputError("two measurements have the same name; rename one")
    return Plan(
        source,
        given.voxel_sha256,
        trajectories,
        _landmarks(document.landmarks) if document.landmarks else None,
        tuple(_change(entry, source.frame) for entry in document.history),
        tuple(_change(entry, source.frame) for entry in document.undone),
        document.revision,
        rulers,
    )


def _entry(item: Item | None) -> dict[str, Any] | None:
    if item is None:
        return None
    if isinstance(item, Landmarks):
        return {"ac": _list(item.ac_mm), "pc": _list(item.pc_mm), "midline": _list(item.midline_mm)}
    if isinstance(item, Ruler):
        return {"name": item.name, "points": [_list(point) for point in item.points_mm]}
    return {
        "name": item.name,
        "entry": _list(item.entry_mm),
        "target": _list(item.target_mm),
        "instrument": {
            "name": item.instrument.name,
            "diameter_mm": item.instrument.diameter_mm,
            "length_mm": item.instrument.length_mm,
        },
        "colour": item.colour,
        "locked": item.locked,
        "notes": item.notes,
        **({"electrode": item.electrode.name} if item.electrode else {}),
    }


def _list(place_mm: FloatArray) -> list[float]:
    return [float(value) for value in place_mm]


def _change_entry(change: Change) -> dict[str, Any]:
    return {
        "time": change.time,
        "action": change.action,
        "index": change.index,
        "before": _entry(change.before),
        "after": _entry(change.after),
    }


def _trajectory(entry: TrajectoryEntry, frame: Frame) -> Trajectory:
    instrument = entry.instrument
    return Trajectory(
        entry.name,
        np.array(entry.entry),
        np.array(entry.target),
        frame,
        Instrument(instrument.name, instrument.diameter_mm, instrument.length_mm),
        entry.colour,
        entry.locked,
        entry.notes,
        electrode_named(entry.electrode) if entry.electrode is not None else None,
    )


def _landmarks(entry: LandmarksEntry) -> Landmarks:
    return Landmarks(np.array(entry.ac), np.array(entry.pc), np.array(entry.midline))


def _ruler(entry: RulerEntry) -> Ruler:
    return Ruler(entry.name, np.array(entry.points))


def _change(entry: ChangeEntry, frame: Frame) -> Change:
    def item(one: ItemEntry | None) -> Item | None:
        if one is None:
            return None
        if isinstance(one, RulerEntry):
            return _ruler(one)
        return _landmarks(one) if isinstance(one, LandmarksEntry) else _trajectory(one, frame)

    before, after = item(entry.before), item(entry.after)
    if before is not None and after is not None and type(before) is not type(after):
        raise InputError(f"the change '{entry.action}' makes one kind of thing of another; correct the history")
    return Change(entry.time, entry.action, entry.index, before, after)
