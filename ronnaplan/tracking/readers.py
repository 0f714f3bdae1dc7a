"""One door for every kind of readings file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final, NamedTuple

from ronnaplan.errors import check_type
from ronnaplan.tracking.csv_file import read_csv
from ronnaplan.tracking.fillers import flag_fillers
from ronnaplan.tracking.matrix_csv import has_matrices, read_matrices
from ronnaplan.tracking.ndi_csv import is_ndi, read_ndi
from ronnaplan.tracking.recording import Recording
from ronnaplan.tracking.sequences import read_sequence, seems_sequence
from ronnaplan.tracking.slicer import (
    has_control_points,
    read_control_points,
    read_fcsv,
    read_markups,
    seems_markups,
)
from ronnaplan.tracking.tables import read_rows, seems_table


def read_recording(path: str | Path) -> Recording:
    """Read tracker readings from ``path``: CSV, NDI CSV, matrices in rows, Slicer markups or a sequence.

    The kind is told by the file's ending (`READERS`), and among tables by the header: what ends otherwise is read as
    one. Raises `InputError` for a file that is none of them.
    """
    check_type(path, (str, Path), "the path of the readings", "give the path of a file")
    file = Path(path)
    return flag_fillers(READERS.get(file.suffix.lower(), TABLE).read(file))


def may_hold_readings(name: str, beginning: bytes) -> bool:
    """Whether a file called ``name`` whose first `BEGINNING_BYTES` are ``beginning`` is worth reading.

    One is where `read_recording` would say what is wrong with its readings; other documents, images and texts are not.
    """
    kind = READERS.get(Path(name).suffix.lower())
    return kind is not None and kind.seems(beginning)


def _read_table(file: Path) -> Recording:
    header, _, _ = read_rows(file)
    if has_matrices(header):
        return read_matrices(file)
    if has_control_points(header):
        return read_control_points(file)
    return read_ndi(file) if is_ndi(header) else read_csv(file)


class Reader(NamedTuple):
    """How files of a kind are read, and whether one that begins so seems to be of it."""

    read: Callable[[Path], Recording]
    seems: Callable[[bytes], bool]


BEGINNING_BYTES: Final = 2**16
"""More than the longest header of a table."""

TABLE: Final = Reader(_read_table, seems_table)

READERS: Final[Mapping[str, Reader]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt"), TABLE),
    **dict.fromkeys((".mha", ".mhd", ".nrrd", ".nhdr"), Reader(read_sequence, seems_sequence)),
    ".json": Reader(read_markups, seems_markups),
    ".fcsv": Reader(read_fcsv, bool),
}
"""How a readings file's name may end, and what reads it."""
