"""The entries and targets of a plan file, as points of the scan they were planned in."""

from __future__ import annotations

import os
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from ronnaplan.documents.fiducials import Source, Vector
from ronnaplan.documents.files import read_json
from ronnaplan.errors import InputError
from ronnaplan.geometry import Frame, Points

FORMAT = "ronnaplan.plan"


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")


class _Trajectory(_Model):
    name: str
    entry: Vector
    target: Vector


class _Plan(_Model):
    version: Literal[1]
    coordinate_system: Literal["LPS"]
    unit: Literal["mm"]
    source: Source
    trajectories: tuple[_Trajectory, ...] = ()


def planned_points(path: str | os.PathLike[str]) -> Points:
    """Return ``<name> entry`` and ``<name> target`` of every trajectory in a plan file (LPS mm, exact)."""
    content = read_json(path)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(f"{os.fspath(path)} is not a plan; expected the format '{FORMAT}'")
    try:
        plan = _Plan.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the plan"
        raise InputError(f"{os.fspath(path)}: {where}: {first['msg']}; write it anew with plan") from error
    places = [place for one in plan.trajectories for place in (one.entry, one.target)]
    labels = tuple(f"{one.name} {end}" for one in plan.trajectories for end in ("entry", "target"))
    frame = Frame("CT", plan.source.frame_of_reference_uid)
    count = len(places)
    return Points(np.array(places, dtype=np.float64).reshape(count, 3), np.zeros((count, 3, 3)), labels, frame)
