"""Where names of trajectories are written over a picture: beside their entries, within it, and none on another.

The page of an exported scene does the same by itself, in the browser (``page/names.js``): what changes here changes
there, too.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

LETTER_EM = 0.54
"""How wide a letter is on average, in heights of the letters: no more than an estimate, fonts differ."""

ELLIPSIS = "\u2026"
"""What a name ends with that would take more than half of the picture's width; tables have it whole."""

WIDE_EM = 1.0
"""How wide a letter of Chinese, Japanese or Korean, or `ELLIPSIS`, is, in heights of the letters."""

LINE_EM, GAP = 1.15, 0.025
"""From one line of text to the next; and from an entry to its name, in halves of the picture's shorter side."""

LINES = (0, 1, -1, 2, -2, 3, -3)
"""So many lines down or up a name is tried; where all are taken it stands on another."""

Box = tuple[float, float, float, float]
"""Left, top, right and bottom."""


@dataclass(frozen=True)
class Room:
    """A picture about the origin in its own units: half its width and height, how high its letters are, and how wide.

    ``em`` is their height, ``letter_em`` their average width in heights; so much at the top is the picture's title's.
    """

    wide: float
    high: float
    em: float
    letter_em: float = LETTER_EM
    title: float = 0.0

    def length(self, name: str) -> float:
        """Return how long a name is."""
        wide = sum(letter == ELLIPSIS or unicodedata.east_asian_width(letter) in "WF" for letter in name)
        return self.em * (self.letter_em * (len(name) - wide) + WIDE_EM * wide)

    def shortened(self, name: str) -> str:
        """Return what of a name takes half of the picture's width at most."""
        if self.length(name) <= self.wide:
            return name
        most = min(len(name) - 1, int(self.wide / (self.letter_em * self.em)))
        kept = (name[:count].rstrip() + ELLIPSIS for count in range(most, 0, -1))
        return next((one for one in kept if self.length(one) <= self.wide), ELLIPSIS)

    def box(self, text: str, x: float, y: float, anchor: str = "start") -> Box:
        """Return what a text covers that begins at ``x``, or ends there by its ``anchor``, and stands on ``y``."""
        length = self.length(text)
        left = x - length if anchor == "end" else x
        return left, y - self.em, left + length, y

    @property
    def highest(self) -> float:
        """What a name stands on that is as high as one may be."""
        return self.title + self.em - self.high


def write_labels(drawn: Sequence[dict[str, Any]], room: Room) -> list[dict[str, Any]]:
    """Return what is drawn (x, y, r, label), each with where its label is ``written``, as `write_names` has it.

    A label stands so far as ``r`` to the upper right, or to the left where the picture ends, and not above the picture.
    That of a place outside goes with it.
    """
    labelled = []
    for one in drawn:
        x, y, r = one["x"], one["y"], one["r"]
        text = room.shortened(one["label"])
        anchor, across, down = "start", x + r, y - r
        if abs(x) < room.wide and abs(y) < room.high:
            anchor, across, _ = _across(x, room.length(text), r, room.wide)
            down = max(down, room.highest)
        labelled.append(one | {"written": {"x": across, "y": down, "anchor": anchor, "text": text}})
    return labelled


def write_names(
    paths: Sequence[dict[str, Any]], markers: Sequence[dict[str, Any]], room: Room
) -> list[dict[str, Any]]:
    """Return the paths, each with where its name begins or ends: ``written`` = x, y, the text's anchor and the text.

    A name stands to the right of its entry, or to the left where the picture ends, lines away until it covers no other,
    nor that of one of the ``markers`` (of `write_labels`). That of an entry outside the picture goes with it.
    """
    gap = GAP * min(room.wide, room.high)
    taken = [room.box(**one["written"]) for one in markers]
    drawn = []
    for one in paths:
        x, y = one["entry"]
        text = room.shortened(one["name"])
        anchor, across = "start", x + gap
        if abs(x) < room.wide and abs(y) < room.high:
            anchor, across, left = _across(x, room.length(text), gap, room.wide)
            lines = [max(y - gap, room.highest) + n * LINE_EM * room.em for n in LINES]
            boxes = {down: room.box(text, left, down) for down in lines}
            free = (down for down, box in boxes.items() if not _covers(box, taken))
            y = next((down for down in free if room.highest <= down <= room.high), lines[0])
            taken.append(boxes[y])
        drawn.append(one | {"written": {"x": across, "y": y, "anchor": anchor, "text": text}})
    return drawn


def _across(x: float, length: float, gap: float, wide: float) -> tuple[str, float, float]:
    """Return the anchor of a name so long that belongs to ``x``, where that is, and where the name begins."""
    if x + gap + length <= wide:
        return "start", x + gap, x + gap
    if x - gap - length >= -wide:
        return "end", x - gap, x - gap - length
    left = max(-wide, wide - length)
    return "start", left, left


def _covers(one: Box, others: Sequence[Box]) -> bool:
    return any(
        one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3] for other in others
    )
