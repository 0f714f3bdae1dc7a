"""One door for every kind of readings file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from ronnaplan.errors import check_type
from ronnaplan.tracking.csv_file import read_csv
from ronnaplan.tracking.matrix_csv import has_matrices, read_matrices
from ronnaplan.tracking.ndi_csv import is_ndi, read_ndi
from ronnaplan.tracking.recording import Recording
from ronnaplan.tracking.sequences import read_sequence
from ronnaplan.tracking.slicer import has_control_points, read_control_points, read_fcsv, read_markups
from ronnaplan.tracking.tables import read_rows


def read_recording(path: str | Path) -> Recording:
    """Read tracker readings from ``path``: CSV, NDI CSV, matrices in rows, Slicer markups or a sequence.

    The kind is told by the file's ending (`READERS`), and among tables by the header: what ends otherwise is read as
    one. Raises `InputError` for a file that is none of them.
    """
    check_type(path, (str, Path), "the path of the readings", "give the path of a file")
    file = Path(path)
    return READERS.get(file.suffix.lower(), _read_table)(file)


def _read_table(file: Path) -> Recording:
    header, _, _ = read_rows(file)
    if has_matrices(header):
        return read_matrices(file)
    if has_control_points(header):
        return read_control_points(file)
    return read_ndi(file) if is_ndi(header) else read_csv(file)


READERS: Final[Mapping[str, Callable[[Path], Recording]]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt"), _read_table),
    **dict.fromkeys((".mha", ".mhd", ".nrrd", ".nhdr"), read_sequence),
    ".json": read_markups,
    ".fcsv": read_fcsv,
}
"""How a readings file's name may end, and what reads it."""
