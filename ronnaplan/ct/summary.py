"""What `ronnaplan series` shows of each series: plain values, without the patient unless asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ronnaplan.ct.catalogue import Series, find_series
from ronnaplan.ct.files import Skipped, given_path
from ronnaplan.ct.grid import SliceGrid
from ronnaplan.ct.images import is_image_file, open_image
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.text import printable


@dataclass(frozen=True)
class SeriesSummary:
    """One series at a glance; every text is safe to print.

    ``series`` is what `read_ct` takes as its ``series_uid``. ``spacing_mm`` is the smallest and largest gap
    between slices, ``pixel_mm`` the distance between rows and between columns. A series with ``problems``
    cannot be read; ``notes`` are reasons to doubt one that can, and ``apart`` names what the parts of a series differ
    in, of which this is one; ``part`` is what this one has of it ("kernel H30"), where that is a value.
    """

    series: str
    modality: str
    description: str
    images: int
    matrix: tuple[int, int] | None
    pixel_mm: tuple[float, float] | None
    spacing_mm: tuple[float, float] | None
    tilt_deg: float | None
    kernel: str
    problems: tuple[str, ...]
    notes: tuple[str, ...]
    apart: tuple[str, ...]
    part: tuple[str, ...]
    patient_name: str

    @property
    def is_usable(self) -> bool:
        """Whether it can be read as a CT volume."""
        return not self.problems


def summarize(path: str | Path, *, progress: bool = False) -> tuple[list[SeriesSummary], tuple[Skipped, ...]]:
    """Return a summary of every series below ``path``, and the files that belong to none.

    Raises `InputError` if there is no such path or nothing of use in it.
    """
    path = given_path(path)
    if is_image_file(path) and path.is_file():
        return [_of_image(path)], ()
    found = find_series(path, progress=progress)
    found.require_series()
    return [summary_of(series) for series in found.series], found.skipped


def summary_of(series: Series) -> SeriesSummary:
    """Return a series at a glance."""
    first = series.first
    grid = series.stack.grid if series.stack is not None else None
    pixels = first.pixels
    return SeriesSummary(
        series=series.key,
        modality=first.modality,
        description=first.description,
        images=series.image_count,
        matrix=(pixels.rows, pixels.columns) if pixels is not None else None,
        pixel_mm=None if grid is None else (grid.row_spacing_mm, grid.column_spacing_mm),
        spacing_mm=None if grid is None else _range_mm(grid),
        tilt_deg=None if grid is None else grid.tilt_deg,
        kernel=series.kernel,
        problems=series.problems,
        notes=tuple(str(flag) for flag in series.notes),
        apart=series.apart,
        part=series.part,
        patient_name=first.patient_name,
    )


def _of_image(path: Path) -> SeriesSummary:
    image = open_image(path, DEFAULT_LIMITS)
    return SeriesSummary(
        series=printable(path.name),
        modality="?",
        description="image file, values taken as HU",
        images=image.shape[0],
        matrix=image.shape[1:],
        pixel_mm=(image.grid.row_spacing_mm, image.grid.column_spacing_mm),
        spacing_mm=_range_mm(image.grid),
        tilt_deg=image.grid.tilt_deg,
        kernel="",
        problems=(),
        notes=tuple(str(flag) for flag in image.flags),
        apart=(),
        part=(),
        patient_name="",
    )


def _range_mm(grid: SliceGrid) -> tuple[float, float]:
    return float(grid.spacings_mm.min()), float(grid.spacings_mm.max())
