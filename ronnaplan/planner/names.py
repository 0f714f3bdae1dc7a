"""Where names of trajectories are written over a view: beside their entries, in the pane, and none on another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ronnaplan.planner.panes import Pane

EM_PIXELS, LETTER_EM = 12.0, 0.54
"""Height of the letters, and how wide one is on average: no more than an estimate, fonts differ."""

LINE_EM, GAP = 1.15, 0.025
"""From one line of text to the next; and from an entry to its name, in halves of the view."""

LINES = (0, 1, -1, 2, -2, 3, -3)
"""So many lines down or up a name is tried; where all are taken it stands on another."""

Box = tuple[float, float, float, float]
"""Left, top, right and bottom."""


def write_names(
    paths: Sequence[dict[str, Any]], markers: Sequence[dict[str, Any]], pane: Pane, half: float
) -> list[dict[str, Any]]:
    """Return the paths, each with where its name begins or ends: ``written`` = x, y and the text's anchor.

    A name stands to the right of its entry, or to the left where the pane ends, lines away until it covers no other,
    nor that of a marker. That of an entry outside the pane goes with it. ``half`` is that of the shorter side in the
    view's units.
    """
    em = 2 * half * EM_PIXELS / max(min(pane.width, pane.height), 1.0)
    wide, high = (half * share for share in pane.halves)
    taken = [_box(one["label"], one["x"] + one["r"], one["y"] - one["r"], em) for one in markers]
    drawn = []
    for one in paths:
        x, y = one["entry"]
        anchor, across = "start", x + GAP * half
        if abs(x) < wide and abs(y) < high:
            anchor, across, left = _across(x, _width(one["name"], em), GAP * half, wide)
            lines = [max(y - GAP * half, em - high) + n * LINE_EM * em for n in LINES]
            boxes = {down: _box(one["name"], left, down, em) for down in lines}
            y = next(
                (down for down, box in boxes.items() if box[1] >= -high and not _covers(box, taken)), lines[0]
            )
            taken.append(boxes[y])
        drawn.append(one | {"written": {"x": across, "y": y, "anchor": anchor}})
    return drawn


def _across(x: float, length: float, gap: float, wide: float) -> tuple[str, float, float]:
    """Return the anchor of a name so long that belongs to ``x``, where that is, and where the name begins."""
    if x + gap + length <= wide:
        return "start", x + gap, x + gap
    if x - gap - length >= -wide:
        return "end", x - gap, x - gap - length
    left = max(-wide, wide - length)
    return "start", left, left


def _width(name: str, em: float) -> float:
    return LETTER_EM * em * len(name)


def _box(name: str, left: float, base: float, em: float) -> Box:
    return left, base - em, left + _width(name, em), base


def _covers(one: Box, others: Sequence[Box]) -> bool:
    return any(
        one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3] for other in others
    )
