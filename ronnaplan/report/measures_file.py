"""What was measured and judged of a case's trajectories as CSV, one row each: for a spreadsheet."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from ronnaplan.case.folder import Case
from ronnaplan.case.judgement import Judgement
from ronnaplan.errors import InputError
from ronnaplan.planning import Measures
from ronnaplan.planning.rows import errors_by_basis, verdict_sentence
from ronnaplan.planning.uncertainty import PathError
from ronnaplan.tracking.cells import plain_text

SHAPE_COLUMNS = (
    *("length_mm", "depth_below_scalp_mm", "depth_below_skull_mm", "skull_thickness_mm", "skull_angle_deg"),
    *("arc_deg", "ring_deg"),
)
ACPC_COLUMNS = ("mcp_right_mm", "mcp_anterior_mm", "mcp_superior_mm", "acpc_sagittal_deg", "acpc_coronal_deg")
"""The target's place from the mid-commissural point, and the path's angles in the AC-PC frame."""

ERROR_COLUMNS = ("entry_rms_mm", "target_rms_mm", "angular_rms_deg", "tolerance_mm", "probability")
HEADER = (
    *("case", "name", *SHAPE_COLUMNS, *ACPC_COLUMNS),
    *(f"{basis}_{column}" for basis in ("planned", "registered") for column in ERROR_COLUMNS),
    *("verdict", "remarks", "frame_of_reference_uid"),
)


def measures_csv(case: Case, name: str) -> str:
    """Return the measures and the verdict of every trajectory of the case that is called ``name``.

    ``verdict`` is pass, FAIL, or, with the reason among the remarks, not judged; what is not known is left empty.
    Raises `InputError` for a case without a trajectory, or without its scan.
    """
    if case.plan is None or not case.plan.trajectories:
        raise InputError(f"{name} holds no trajectory to be measured; add one to its plan")
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(HEADER)
    uid = plain_text(case.plan.frame.uid or "")
    for one, judged in zip(case.plan.trajectories, case.judgements, strict=True):
        remarks = plain_text("; ".join((*_remarks(judged), *case.surroundings.doubts)))
        named = (plain_text(name), plain_text(one.name))
        writer.writerow((*named, *map(_cell, _values(judged.measures)), _verdict(judged), remarks, uid))
    return stream.getvalue()


def _values(one: Measures | None) -> Iterator[float | None]:
    if one is None:
        yield from [None] * (len(SHAPE_COLUMNS) + len(ACPC_COLUMNS) + 2 * len(ERROR_COLUMNS))
        return
    yield from (one.length_mm, one.depth_below_scalp_mm, one.depth_below_skull_mm, one.skull_thickness_mm)
    yield from (one.skull_angle_deg, one.arc.arc_deg, one.arc.ring_deg)
    acpc = one.acpc
    yield from (*acpc.target_mm, acpc.sagittal_deg, acpc.coronal_deg) if acpc else [None] * len(ACPC_COLUMNS)
    for error in errors_by_basis(one):
        yield from _error(error) if error else [None] * len(ERROR_COLUMNS)


def _error(error: PathError) -> tuple[float, ...]:
    rms = (error.entry_rms_mm, error.target_rms_mm, error.angular_rms_deg)
    return (*rms, error.tolerance_mm, error.probability)


def _cell(value: float | None) -> str:
    return "" if value is None else repr(float(value))  # whole: a chance of 0.99996 is none of 1


def _verdict(judged: Judgement) -> str:
    if judged.problem:
        return "not judged"
    return "FAIL" if judged.broken else "pass"


def _remarks(judged: Judgement) -> Iterator[str]:
    yield from (judged.problem,) if judged.problem else ()
    yield from map(verdict_sentence, judged.broken)
    yield from judged.doubts
