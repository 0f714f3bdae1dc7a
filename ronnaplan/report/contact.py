"""A contact sheet: every accepted and nearly accepted candidate, three cuts each, and what the model leaves over."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import CTVolume
from ronnaplan.ct.sampling import sampled
from ronnaplan.ct.volume import WAYS_TO_A_VOLUME
from ronnaplan.errors import check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import Fiducials
from ronnaplan.localization.fit.parameters import BACKGROUND, CENTER, CONTRAST, RADIUS
from ronnaplan.report.picture import CUTS, OUTLINE_COLOUR, WINDOW_HU, cut_places

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

NEARLY_SHOWN = 8
"""Rejected candidates on the sheet, nearest to acceptance first."""

RESIDUAL_SHARE = 0.1
"""Residuals are drawn from minus to plus this share of the contrast."""

LEGEND = (
    "orange: the fitted outline   red title: rejected   left over: the scan less the model, "
    f"red where it is brighter, blue where darker, full at {RESIDUAL_SHARE:.0%} of the marker's contrast"
)

TILE = 150
"""Pixels of a cut on the sheet, across and down."""

_PITCH_ACROSS, _PITCH_DOWN, _MARGIN, _DPI = 180, 171, 19, 90
_WIDTH = 2 * len(CUTS) * _PITCH_ACROSS
_LEFTS = range(_MARGIN, _WIDTH, _PITCH_ACROSS)
"""Where the tiles of a row begin."""
_HEADING = 48
"""Pixels of the sheet's heading, above the first row."""
_LETTERS_PT = 14
"""Of a row alone: on paper it is little more than half as large."""
_ROUNDING = 0.01
"""Pixels: matplotlib cuts what is a little less than a whole number of them."""


@dataclass(frozen=True)
class Candidate:
    """A fitted place: its center (3,) in LPS mm and the model's parameters."""

    title: str
    center_mm: FloatArray
    parameters: FloatArray
    accepted: bool
    layer_mm: float = 0.0
    profile_axis: FloatArray | None = None
    """Unit vector (3,) in LPS along which the slices' profile blurs; None where that is their normal."""


Pair = tuple[NDArray[np.float32], NDArray[np.float32]]
"""A cut through a fitted place, in HU, and what the model leaves over of it."""

Row = tuple[Candidate, list[Pair]]
"""A candidate and a pair for each of `CUTS`."""


def contact_sheet(volume: CTVolume, found: Fiducials | None) -> bytes:
    """Draw cuts and residuals of each candidate in a row; returns a PNG. None: no ball of any size was seen."""
    check_type(volume, CTVolume, "the volume", WAYS_TO_A_VOLUME)
    if found is not None:
        check_type(found, Fiducials, "what was found", "localize returns it")
    return draw_sheet([] if found is None else gathered(volume, found))


def gathered(volume: CTVolume, found: Fiducials) -> list[Row]:
    """Return all of a scan that its sheet shows: who draws it needs no voxels."""
    return [(row, cut_pairs(volume, row)) for row in _rows(found)]


def draw_sheet(gathered: list[Row]) -> bytes:
    """Draw what was `gathered`; returns a PNG."""
    from PIL import Image

    strips = [_strip(_tiles(*row), partial(_draw_over, row=row[0])) for row in gathered]
    strips = strips or [_strip((), _write_none)]
    sheet = Image.new("RGB", (_WIDTH, _HEADING + len(strips) * _PITCH_DOWN + _MARGIN), "white")
    heading = Image.fromarray(_drawn(_HEADING, _write_heading))
    sheet.paste(heading, mask=heading)
    for number, strip in enumerate(strips):
        sheet.paste(strip, (0, _HEADING + number * _PITCH_DOWN))
    return _png(sheet)


def draw_row(row: Candidate, pairs: list[Pair]) -> bytes:
    """Draw one fitted place, its cuts named in letters that can be read on paper; returns a PNG."""

    def over(axes: Axes) -> None:
        _write_columns(axes, _MARGIN / 2, _LETTERS_PT)
        _draw_outlines(axes, row)

    return _png(_strip(_tiles(row, pairs), over))


def _png(image: Image) -> bytes:
    stream = io.BytesIO()
    image.save(stream, format="png")
    return stream.getvalue()


def _strip(tiles: Iterable[NDArray[np.uint8]], draw: Callable[[Axes], None]) -> Image:
    """Return a row of tiles, and over it what ``draw`` draws."""
    from PIL import Image

    strip = Image.new("RGBA", (_WIDTH, _PITCH_DOWN), "white")
    for left, tile in zip(_LEFTS, tiles, strict=False):
        strip.paste(Image.fromarray(tile), (left, _MARGIN))
    strip.alpha_composite(Image.fromarray(_drawn(_PITCH_DOWN, draw)))
    return strip.convert("RGB")


def _drawn(height: int, draw: Callable[[Axes], None]) -> NDArray[np.uint8]:
    """Return what ``draw`` draws in axes of pixels, as (height, `_WIDTH`, RGBA).

    All of a row are in one pair of axes, and the tiles in none: a pair for each of a hundred takes seconds to lay out
    and to draw, and an image in one takes thirty times its bytes meanwhile.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from ronnaplan.letters import written_out

    size = ((_WIDTH + _ROUNDING) / _DPI, (height + _ROUNDING) / _DPI)
    figure = Figure(figsize=size, dpi=_DPI, facecolor="none")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0, _WIDTH), ylim=(height, 0))
    axes.set_axis_off()
    draw(axes)
    written_out(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="rgba", facecolor="none")
    return np.frombuffer(stream.getbuffer(), np.uint8).reshape(height, _WIDTH, 4)


def _write_heading(axes: Axes) -> None:
    """Say what the colours mean, and what is in each column."""
    axes.text(_MARGIN, _MARGIN, LEGEND, fontsize=7, va="center")
    _write_columns(axes, _HEADING - 8, 8)


def _write_columns(axes: Axes, middle: float, fontsize: float) -> None:
    for left, name in zip(_LEFTS, (name for cut in CUTS for name in (cut, "left over")), strict=True):
        axes.text(left + TILE / 2, middle, name, fontsize=fontsize, ha="center", va="center")


def _write_none(axes: Axes) -> None:
    axes.text(_WIDTH / 2, _PITCH_DOWN / 2, "no candidate was looked at closely", ha="center")


def _draw_over(axes: Axes, row: Candidate) -> None:
    """Draw title and outlines of a row."""
    axes.text(_MARGIN, _MARGIN - 6, row.title, fontsize=7, color="black" if row.accepted else "firebrick")
    _draw_outlines(axes, row)


def _draw_outlines(axes: Axes, row: Candidate) -> None:
    from matplotlib.collections import EllipseCollection

    sizes = np.full(len(_LEFTS), row.parameters[RADIUS] / _reach_mm(row) * TILE)
    outlines = EllipseCollection(
        *(sizes, sizes, np.zeros(len(sizes))),
        units="xy",
        offsets=np.array([(left, _MARGIN) for left in _LEFTS]) + TILE / 2,
        offset_transform=axes.transData,
        facecolors="none",
        edgecolors=OUTLINE_COLOUR,
        linewidths=0.8,
    )
    axes.add_collection(outlines, autolim=False)


def _tiles(row: Candidate, pairs: list[Pair]) -> Iterator[NDArray[np.uint8]]:
    """Yield each cut through a fitted place, and what the model leaves over of it, as colours (TILE, TILE, 3)."""
    from matplotlib import colormaps
    from PIL import Image

    def scaled(image: NDArray[np.float32], low: float, high: float) -> FloatArray:
        tile = np.asarray(Image.fromarray(image).resize((TILE, TILE), Image.Resampling.BICUBIC))
        return np.asarray((tile - low) / (high - low) if high > low else np.zeros(tile.shape))

    lowest_hu, highest_hu, limit_hu = _windows(row)
    for cut, (data, rest) in zip(CUTS, pairs, strict=True):
        if cut != "axial":
            data, rest = data[::-1], rest[::-1]
        yield colormaps["gray"](scaled(data, lowest_hu, highest_hu), bytes=True)[..., :3]
        yield colormaps["RdBu_r"](scaled(rest, -limit_hu, limit_hu), bytes=True)[..., :3]


def _rows(found: Fiducials) -> list[Candidate]:
    accepted = [
        Candidate(
            f"{one.label}: error {1e3 * one.error_rms_mm:.1f} um RMS, misfit {one.misfit:.1%}, "
            f"{one.coverage:.0%} of the surface used",
            one.center_mm,
            one.parameters,
            accepted=True,
            layer_mm=found.marker.layer_mm,
            profile_axis=found.profile_axis,
        )
        for one in found.fiducials
    ]
    nearly = [
        Candidate(
            f"rejected: {one.reason}",
            one.fitted_mm,
            one.parameters,
            accepted=False,
            layer_mm=found.marker.layer_mm,
            profile_axis=found.profile_axis,
        )
        for one in found.rejected[:NEARLY_SHOWN]
    ]
    return accepted + nearly


def cut_pairs(volume: CTVolume, row: Candidate) -> list[Pair]:
    """Return what is drawn of a fitted place for each of `CUTS`."""
    return [cut_pair(volume, row, cut) for cut in CUTS]


def cut_pair(volume: CTVolume, row: Candidate, cut: str) -> Pair:
    """Return one cut of a fitted place."""
    indices = volume.grid.indices(cut_places(row.center_mm, CUTS[cut], _reach_mm(row)))
    return sampled(volume.voxels_hu, indices, WINDOW_HU[0]), _left_over(volume, row, indices)


def _reach_mm(row: Candidate) -> float:
    """Half the width of a cut."""
    return float(1.6 * row.parameters[RADIUS] + 1.0)


def _windows(row: Candidate) -> tuple[float, float, float]:
    """Return what is black and what is white on a cut, and what is the deepest colour of a residual (HU)."""
    contrast_hu, background_hu = row.parameters[[CONTRAST, BACKGROUND]]
    low, high = background_hu - 0.1 * contrast_hu, background_hu + 1.3 * contrast_hu
    return low, high, RESIDUAL_SHARE * abs(contrast_hu)


def _left_over(volume: CTVolume, row: Candidate, indices: FloatArray) -> NDArray[np.float32]:
    """The voxels about ``indices`` (..., 3) less the fitted model, in HU: compared voxel by voxel, as the fit does."""
    from ronnaplan.localization.fit.ball import discs
    from ronnaplan.localization.fit.model import evaluate
    from ronnaplan.localization.fit.neighbourhood import axes_along

    grid = volume.grid
    flat = indices.reshape(-1, 3)
    low = np.clip(np.floor(flat.min(axis=0)), 0, np.subtract(volume.voxels_hu.shape, 1)).astype(int)
    high = np.clip(np.ceil(flat.max(axis=0)) + 1, low + 1, volume.voxels_hu.shape).astype(int)
    box = volume.voxels_hu[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    places = grid.positions_mm(low.astype(np.float64) + np.moveaxis(np.indices(box.shape), 0, -1))
    at_center = row.parameters.copy()
    at_center[CENTER] = 0.0
    offsets = np.ascontiguousarray(
        (places - row.center_mm).reshape(-1, 3) @ axes_along(grid.axes, row.profile_axis).T
    )
    model, _ = evaluate(offsets, at_center, row.layer_mm, *discs(at_center))
    return sampled((box - model.reshape(box.shape)).astype(np.float32), indices - low, 0.0)
