"""Pictures of points in a patient or before a tracker; imported where one is drawn, as it imports matplotlib."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray, Frame
from ronnaplan.letters import written_out

VIEWS = {"axial": (0, 1), "coronal": (0, 2), "sagittal": (1, 2)}
"""The two axes of a view, across and upwards (downwards for axial, as radiologists look)."""

IN_PATIENT = ("x mm (right to left)", "y mm (front to back)", "z mm (feet to head)")

FIELD_TICKS, FIELD_LEVELS = 61, 10
"""Places along each axis at which a field is looked at, and how many levels its contours have at most."""

MARKER_COLOUR, QUIET_COLOUR, DOUBT_COLOUR = "#d1495b", "#7a8b99", "#00798c"
OUTLINED = [withStroke(linewidth=2.5, foreground="white")]
"""Of letters, to be read before any background."""
MARGIN_MM, WIDER = 25.0, 1.2
"""Shown about the outermost points, and by how much more where nothing else gives the frame: labels stand there."""


class Picture(Figure):
    """A matplotlib figure that a notebook shows by itself; ``savefig`` writes it."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__(figsize=(width, height), dpi=90, layout="constrained")
        FigureCanvasAgg(self)

    def draw(self, renderer: RendererBase) -> None:
        """Draw the picture, its names by the letter."""
        written_out(self)
        super().draw(renderer)

    def png(self) -> bytes:
        """Return the picture as a PNG."""
        stream = io.BytesIO()
        self.savefig(stream, format="png")
        return stream.getvalue()

    def _repr_png_(self) -> bytes:
        return self.png()


@dataclass(frozen=True, eq=False)
class Head:
    """A picture (H, W, 4) of a head in 3-D, what to call it, and names to write on it, each in its colour.

    They stand at places (N, 2), to the right and down from its middle in halves of its shorter side.
    """

    shades: NDArray[np.uint8]
    title: str
    names: Sequence[str]
    colours: Sequence[str]
    places: FloatArray


class ThreeViews:
    """Three projections of one scene, beside each other; points are (N, 3) in mm.

    They are in the patient's axes, or in those of ``frame``, where that is another's. With a ``head``, that is a
    fourth, before them.
    """

    def __init__(self, title: str, *, frame: Frame | None = None, head: Head | None = None) -> None:
        height, rows, columns = (3.9, 1, 3) if head is None else (9.8, 2, 2)
        self.picture = Picture(11.0, height)
        self.picture.suptitle(title, fontsize=10)
        all_axes = list(self.picture.subplots(rows, columns).flat)
        if head is not None:
            _draw_head(all_axes.pop(0), head)
        names = IN_PATIENT if frame is None else tuple(f"{axis} mm in {frame}" for axis in "xyz")
        self._panes: dict[tuple[int, int], Any] = {}
        for axes, (view, (across, up)) in zip(all_axes, VIEWS.items(), strict=True):
            axes.set_xlabel(names[across], fontsize=8)
            axes.set_ylabel(names[up], fontsize=8)
            axes.tick_params(labelsize=7)
            axes.set_aspect("equal")
            if frame is None:
                axes.set_title(view, fontsize=9)
                if view == "axial":
                    axes.invert_yaxis()
            self._panes[across, up] = axes

    def points(self, places_mm: FloatArray, labels: Sequence[str] = (), colours: Sequence[str] = ()) -> None:
        """Draw points (N, 3), named where there are labels, each of its own colour where there are colours."""
        shown = colours or [MARKER_COLOUR] * len(places_mm)
        for (across, up), axes in self._panes.items():
            axes.scatter(places_mm[:, across], places_mm[:, up], s=36, c=shown, zorder=3)
        if labels:
            self.names(places_mm, labels, shown, places_mm)

    def names(
        self, places_mm: FloatArray, labels: Sequence[str], colours: Sequence[str], beyond_mm: FloatArray
    ) -> None:
        """Write labels above or below places (N, 3), away from others (N, 3), to be read before any background."""
        for (across, up), axes in self._panes.items():
            turn = -1 if axes.yaxis_inverted() else 1
            for place, label, colour, other in zip(places_mm, labels, colours, beyond_mm, strict=True):
                above = turn * (place[up] - other[up]) >= 0
                axes.annotate(
                    label,
                    (place[across], place[up]),
                    xytext=(0, 6 if above else -6),
                    textcoords="offset points",
                    ha="center",
                    va="bottom" if above else "top",
                    fontsize=8,
                    color=_dark(colour),
                    zorder=4,
                    path_effects=OUTLINED,
                )

    def frame(self, places_mm: FloatArray) -> None:
        """Show the same width about places (N, 3) in every view, with a margin about the outermost."""
        if len(places_mm) == 0:
            return
        low, high = places_mm.min(axis=0), places_mm.max(axis=0)
        reach = WIDER * float((high - low).max()) / 2 + MARGIN_MM
        for (across, up), axes in self._panes.items():
            middle, turn = (low + high) / 2, -1 if axes.yaxis_inverted() else 1
            axes.set_xlim(middle[across] - reach, middle[across] + reach)
            axes.set_ylim(middle[up] - turn * reach, middle[up] + turn * reach)

    def segments(self, starts_mm: FloatArray, ends_mm: FloatArray, colours: Sequence[str]) -> None:
        """Draw a line from each start (N, 3) to its end (N, 3)."""
        for (across, up), axes in self._panes.items():
            for start, end, colour in zip(starts_mm, ends_mm, colours, strict=True):
                axes.plot([start[across], end[across]], [start[up], end[up]], color=colour, linewidth=1.6)

    def silhouettes(self, images: Mapping[tuple[int, int], tuple[NDArray[Any], tuple[float, ...]]]) -> None:
        """Lay an image beneath each view: of the axes (across, up), its values and (left, right, bottom, top)."""
        for view, (image, extent) in images.items():
            axes = self._panes[view]
            upside_down = axes.yaxis_inverted()
            look = {"cmap": "gray", "vmin": -1000.0, "vmax": 1500.0, "interpolation": "bilinear"}
            axes.imshow(image, extent=extent, origin="lower", zorder=-1, **look)
            if upside_down and not axes.yaxis_inverted():
                axes.invert_yaxis()

    def fields(
        self,
        values: Callable[[FloatArray], FloatArray],
        middle_mm: FloatArray,
        low_mm: FloatArray,
        high_mm: FloatArray,
        label: str,
    ) -> None:
        """Draw contours of ``values`` (points (N, 3) -> (N,)) in the three planes through ``middle_mm`` (3,).

        They reach from the corner ``low_mm`` (3,) to the corner ``high_mm`` (3,) and leave out what is NaN.
        Dotted lines show where they meet.
        """
        ticks = np.linspace(low_mm, high_mm, FIELD_TICKS)
        planes = []
        for across, up in self._panes:
            places = np.broadcast_to(middle_mm, (FIELD_TICKS, FIELD_TICKS, 3)).copy()
            places[..., across] = ticks[:, across]
            places[..., up] = ticks[:, up, np.newaxis]
            planes.append(values(places.reshape(-1, 3)).reshape(FIELD_TICKS, FIELD_TICKS))
        levels = MaxNLocator(FIELD_LEVELS, steps=[1, 2, 5, 10]).tick_values(np.nanmin(planes), np.nanmax(planes))
        for ((across, up), axes), plane in zip(self._panes.items(), planes, strict=True):
            drawn = axes.contourf(
                ticks[:, across], ticks[:, up], np.ma.masked_invalid(plane), levels, cmap="Blues", zorder=-1
            )
            axes.axvline(middle_mm[across], color=QUIET_COLOUR, linewidth=0.6, linestyle=":")
            axes.axhline(middle_mm[up], color=QUIET_COLOUR, linewidth=0.6, linestyle=":")
        bar = self.picture.colorbar(drawn, ax=list(self._panes.values()), shrink=0.8)
        bar.set_label(label, fontsize=8)
        bar.ax.tick_params(labelsize=7)


def _draw_head(axes: Any, head: Head) -> None:
    """Show a head in 3-D, with its names."""
    high, wide = np.array(head.shades.shape[:2]) / min(head.shades.shape[:2])
    axes.imshow(head.shades, extent=(-wide, wide, -high, high), interpolation="antialiased")
    axes.set_title(head.title, fontsize=9)
    axes.set_axis_off()
    for name, colour, (across, down) in zip(head.names, head.colours, head.places, strict=True):
        axes.annotate(
            name,
            (across, -down),
            xytext=(8, 8),
            textcoords="offset points",
            fontsize=9,
            color=_dark(colour),
            path_effects=OUTLINED,
        )


def _dark(colour: str) -> tuple[float, float, float]:
    """Return a colour dark enough for letters outlined in white."""
    red, green, blue = to_rgb(colour)
    return 0.6 * red, 0.6 * green, 0.6 * blue
