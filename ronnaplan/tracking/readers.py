"""One door for every kind of readings file."""

from __future__ import annotations

from pathlib import Path

from ronnaplan.tracking.csv_file import read_csv
from ronnaplan.tracking.matrix_csv import has_matrices, read_matrices
from ronnaplan.tracking.ndi_csv import is_ndi, read_ndi
from ronnaplan.tracking.recording import Recording
from ronnaplan.tracking.sequences import read_sequence
from ronnaplan.tracking.slicer import read_fcsv, read_markups
from ronnaplan.tracking.tables import read_rows


def read_recording(path: str | Path) -> Recording:
    """Read tracker readings from ``path``: CSV, NDI CSV, matrices in rows, Slicer markups or a sequence.

    The kind is told by the file's ending, and among CSV files by the header. Raises `InputError` for a file
    that is none of them.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix in (".mha", ".mhd", ".nrrd", ".nhdr"):
        return read_sequence(file)
    if suffix == ".json":
        return read_markups(file)
    if suffix == ".fcsv":
        return read_fcsv(file)
    header, _, _ = read_rows(file)
    if has_matrices(header):
        return read_matrices(file)
    return read_ndi(file) if is_ndi(header) else read_csv(file)
