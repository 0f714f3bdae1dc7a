"""Parquet tables of a cohort: one row a marker, and one row a series (or part of one) with what became of it.

They hold nothing of when or where the work was done: the same scans and settings give the same tables.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ronnaplan import __version__
from ronnaplan.cohort.index import Index
from ronnaplan.errors import InputError
from ronnaplan.geometry import rms_mm
from ronnaplan.jobs.serving import DONE
from ronnaplan.portable import replace

if TYPE_CHECKING:
    from pyarrow import Schema

MARKERS, SERIES = "markers.parquet", "series.parquet"
BATCH: Final = 10_000
"""Rows that are held in memory at one time."""

_SCAN: Final = {
    **dict.fromkeys(
        ("modality", "description", "protocol", "manufacturer", "model", "serial", "station"), "string"
    ),
    **dict.fromkeys(("scanner_software", "kernel", "acquired", "acquired_time"), "string"),
    **dict.fromkeys(("kilovolts", "exposure_mas", "ctdi_vol_mgy"), "double"),
    **dict.fromkeys(("slices", "rows", "columns"), "int32"),
    **dict.fromkeys(("thickness_mm", "spacing_mm", "pixel_mm", "tilt_deg"), "double"),
    "scan_flags": "strings",
}
_WHERE: Final = dict.fromkeys(("root", "archive", "folder", "study_uid", "series_uid", "series", "rule"), "string")
_ERROR: Final = ("error_rms_mm", "standard_error_mm")
"""The column of a marker's error, and the name that it had in 0.2, which goes after 0.3."""
_COVARIANCE: Final = ((0, 0, "xx"), (0, 1, "xy"), (0, 2, "xz"), (1, 1, "yy"), (1, 2, "yz"), (2, 2, "zz"))
_MARKER: Final = {
    "label": "string",
    **dict.fromkeys(("x_mm", "y_mm", "z_mm"), "double"),
    **dict.fromkeys((f"covariance_{name}_mm2" for _, _, name in _COVARIANCE), "double"),
    **dict.fromkeys((*_ERROR, "diameter_mm", "contrast_hu", "coverage", "misfit"), "double"),
    "flags": "strings",
}
_OUTCOME: Final = {
    **dict.fromkeys(("state", "reason"), "string"),
    **dict.fromkeys(("files", "found", "expected"), "int32"),
    **dict.fromkeys((*_ERROR, "misfit"), "double"),
    "rejected": "strings",
    "phantom": "string",
    **dict.fromkeys(("distance_mean_mm", "distance_rms_mm", "in_slices_rms_mm", "across_rms_mm"), "double"),
    **dict.fromkeys(("stretch_in_plane", "stretch_along"), "double"),
    "phantom_reasons": "strings",
    **dict.fromkeys(("content", "fiducials", "sheet"), "string"),
}
_SOFTWARE: Final = {"software": "string"}

_QUERY: Final = """
SELECT places.root, places.archive, series.folder, series.study_uid, series.series_uid, series.rule, series.state,
    series.reason, (SELECT COUNT(*) FROM files WHERE files.series = series.id),
    parts.key, parts.state, parts.reason, parts.content, parts.found, parts.expected, parts.scan, parts.markers,
    parts.rejected, parts.checked, parts.fiducials, parts.sheet,
    series.modality, series.description, series.protocol, series.station
FROM series JOIN places ON places.id = series.place
    LEFT JOIN parts ON parts.series = series.id AND series.state != 'left' -- which has the results of an earlier rule
ORDER BY places.root, places.archive, series.study_uid, series.series_uid, parts.number
"""

Row = dict[str, Any]


def write_tables(index: Index, out: Path) -> None:
    """Write both tables anew from the index; raises `InputError` where they cannot be."""
    _write(out / SERIES, {**_WHERE, **_OUTCOME, **_SCAN, **_SOFTWARE}, (row for row, _ in _results(index)))
    markers = (row for series, found in _results(index) for row in _marker_rows(series, found))
    _write(out / MARKERS, {**_WHERE, **_MARKER, **_SCAN, **_SOFTWARE}, markers)


def series_rows(index: Index) -> Iterator[Row]:
    """Yield the rows of the table of series."""
    return (row for row, _ in _results(index))


def _results(index: Index) -> Iterator[tuple[Row, list[Row]]]:
    """Yield each series, or part of one, as a row, with its markers as the document has them."""
    for values in index.each(_QUERY):
        root, archive, folder, study, uid, rule, state, reason, files, key, *part = values
        row: Row = {"root": root, "archive": archive, "folder": folder, "study_uid": study, "series_uid": uid}
        row |= {"series": key or uid, "rule": rule, "state": state, "reason": reason, "files": files}
        row |= dict(zip(("modality", "description", "protocol", "station"), part[-4:], strict=True))
        row["software"] = f"ronnaplan {__version__}"
        markers: list[Row] = []
        if key is not None:
            row |= dict(zip(("state", "reason", "content", "found", "expected"), part[:5], strict=True))
            scan, markers, rejected, checked = (json.loads(text) for text in part[5:9])
            row |= {**scan, **_summed(markers), **_phantom(checked), "rejected": rejected}
            row |= {"fiducials": part[9], "sheet": part[10]}
        yield row, markers


def _summed(markers: list[Row]) -> Row:
    """Return the worst error and misfit of a scan's markers."""
    if not markers:
        return {}
    worst_mm = max(_error_rms_mm(one) for one in markers)
    return {**dict.fromkeys(_ERROR, worst_mm), "misfit": max(one["misfit"] for one in markers)}


def _phantom(checked: Row | None) -> Row:
    if not checked:
        return {}
    told = {name: value for name, value in checked.items() if name not in ("stretches", "reasons")}
    stretches = checked["stretches"]
    return {
        **told,
        "stretch_in_plane": stretches.get("in_plane"),
        "stretch_along": stretches.get("along"),
        "phantom_reasons": checked["reasons"],
    }


def _marker_rows(series: Row, markers: list[Row]) -> Iterator[Row]:
    """Yield the markers of a series that was not refused."""
    if series["state"] != DONE:
        return
    shared = {name: series.get(name) for name in (*_WHERE, *_SCAN, *_SOFTWARE)}
    for one in markers:
        covariance = {f"covariance_{name}_mm2": one["covariance"][i][j] for i, j, name in _COVARIANCE}
        place = dict(zip(("x_mm", "y_mm", "z_mm"), one["center"], strict=True))
        error = dict.fromkeys(_ERROR, _error_rms_mm(one))
        yield {**shared, **{name: one.get(name) for name in _MARKER}, **place, **covariance, **error}


def _error_rms_mm(marker: Row) -> float:
    return float(rms_mm(np.array(marker["covariance"])))


def _schema(columns: dict[str, str]) -> Schema:
    import pyarrow as pa

    kinds = {"string": pa.string(), "double": pa.float64(), "int32": pa.int32(), "strings": pa.list_(pa.string())}
    fields = [pa.field(name, kinds[kind]) for name, kind in columns.items()]
    return pa.schema(fields, metadata={"coordinate_system": "LPS", "unit": "mm"})


def _write(path: Path, columns: dict[str, str], rows: Iterator[Row]) -> None:
    """Write a table beside its place, a batch at a time, then move it there."""
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    schema = _schema(columns)
    beside = path.with_name(f".{path.name}.part")
    try:
        # opened here, for pyarrow takes a folder called a:b for an address
        with beside.open("wb") as file, ParquetWriter(file, schema, compression="zstd") as writer:
            while batch := list(islice(rows, BATCH)):
                table = pa.Table.from_pylist([{name: row.get(name) for name in columns} for row in batch], schema)
                writer.write_table(table)
        replace(beside, path)
    except OSError as error:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise InputError(
            f"cannot write {path}: {error}; make room on its disk, then run the same again"
        ) from error
