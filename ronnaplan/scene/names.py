"""Where names are written over a picture: beside markers, points and entries, within it, and none on another.

The page of an exported scene does the same by itself, in the browser (``page/names.js``): what changes here changes
there, too.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from ronnaplan.text import ELLIPSIS, abridged

LETTER_EM = 0.54
"""How wide a letter is on average, in heights of the letters: no more than an estimate, fonts differ."""

WIDE_EM = 1.0
"""How wide a letter of Chinese, Japanese or Korean, or `ELLIPSIS`, is, in heights of the letters."""

CAPITAL_SHARE, BROAD, BROAD_SHARE = 1.25, "MWmw%@", 1.75
"""How wide a capital letter is, in widths of an average one: many names are all capitals. And the broadest letters."""

KNOWN_NAMES = 4096
"""Of so many the letters are counted once."""

LINE_EM, GAP = 1.15, 0.025
"""From one line of text to the next; and from an entry to its name, in halves of the picture's shorter side."""

LINES = (0, 1, -1, 2, -2, 3, -3)
"""So many lines down or up a name is tried; where all are taken it stands on another."""

ANCHORS = {"start": 0.0, "middle": 0.5, "end": 1.0}
"""What of a text stands left of the place that it is told for."""

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
        wide, capitals, broad = _counted(name)
        more = (CAPITAL_SHARE - 1) * capitals + (BROAD_SHARE - 1) * broad
        return self.em * (self.letter_em * (len(name) - wide + more) + WIDE_EM * wide)

    def shortened(self, name: str) -> str:
        """Return a name, or as much of its beginning and its end as takes half of the picture's width."""
        if self.length(name) <= self.wide:
            return name
        most = min(len(name) - 1, int(self.wide / (self.letter_em * self.em)))
        kept = (abridged(name, count) for count in range(most, 2, -1))
        return next((one for one in kept if self.length(one) <= self.wide), ELLIPSIS)

    def box(self, text: str, x: float, y: float, anchor: str = "start") -> Box:
        """Return what a text covers that begins, ends or has its middle (``anchor``) at ``x``, and stands on ``y``."""
        length = self.length(text)
        left = x - length * ANCHORS[anchor]
        return left, y - self.em, left + length, y

    @property
    def highest(self) -> float:
        """What a name stands on that is as high as one may be."""
        return self.title + self.em - self.high


class Names:
    """What is written over one picture: what is asked for first keeps its place, and nothing covers another.

    Nor does anything cover what is ``taken`` beforehand. Where there is no free place near, none is written: the last
    of several names on each other would be read as that of all.
    """

    def __init__(self, room: Room, taken: Iterable[Box] = ()) -> None:
        self.room = room
        self._taken: dict[int, list[Box]] = {}
        """By the lines of text that they reach into: of hundreds of names few are in a line."""
        for box in taken:
            self._take(box)

    def of_all(
        self,
        paths: Sequence[dict[str, Any]],
        markers: Sequence[dict[str, Any]],
        points: Sequence[dict[str, Any]],
    ) -> dict[str, list[dict[str, Any]]]:
        """Return ``paths``, ``markers`` and ``points``, each with where its name is ``written``.

        The selected path's name goes first, for it is looked at, then those of markers, other paths and points. It
        comes last of the paths, to be drawn over all others.
        """
        chosen = self.of_paths([one for one in paths if one["selected"]])
        named = self.of_places(markers)
        others = self.of_paths([one for one in paths if not one["selected"]])
        return {"paths": [*others, *chosen], "markers": named, "points": self.of_places(points)}

    def of_places(self, drawn: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return what is drawn (x, y, r, label), each with where its label is ``written``: so far as ``r`` from it."""
        return [one | {"written": self._written(one["label"], one["x"], one["y"], one["r"])} for one in drawn]

    def of_paths(self, paths: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return the paths (name, entry), each with where its name is ``written``, beside its entry."""
        gap = GAP * min(self.room.wide, self.room.high)
        places = (one["entry"] for one in paths)
        return [
            one | {"written": self._written(one["name"], x, y, gap)}
            for one, (x, y) in zip(paths, places, strict=True)
        ]

    def _written(self, name: str, x: float, y: float, gap: float) -> dict[str, Any]:
        """Return where a name begins or ends, ``gap`` from its place: x, y, the text's anchor and the text.

        It stands to the upper right, or to the left where the picture ends, lines away until it covers nothing. That of
        a place outside the picture is not written: what of it would be seen could be read as another name.
        """
        room = self.room
        text = room.shortened(name) if abs(x) < room.wide and abs(y) < room.high else ""
        if not text:
            return {"x": x + gap, "y": y - gap, "anchor": "start", "text": ""}
        length = room.length(text)
        anchor, across, left = _across(x, length, gap, room.wide)
        highest = max(y - gap, room.highest)
        for n in LINES:
            down = highest + n * LINE_EM * room.em
            box = (left, down - room.em, left + length, down)
            if room.highest <= down <= room.high and not self._is_taken(box):
                self._take(box)
                return {"x": across, "y": down, "anchor": anchor, "text": text}
        return {"x": across, "y": highest, "anchor": anchor, "text": ""}

    def _take(self, box: Box) -> None:
        for line in self._lines(box):
            self._taken.setdefault(line, []).append(box)

    def _is_taken(self, box: Box) -> bool:
        return any(_covers(box, other) for line in self._lines(box) for other in self._taken.get(line, ()))

    def _lines(self, box: Box) -> range:
        return range(math.floor(box[1] / self.room.em), math.floor(box[3] / self.room.em) + 1)


@lru_cache(KNOWN_NAMES)
def _counted(name: str) -> tuple[int, int, int]:
    """Return how many letters of a name are as wide as high, how many others are capitals, and how many `BROAD`."""
    wide = sum(letter == ELLIPSIS or unicodedata.east_asian_width(letter) in "WF" for letter in name)
    broad = sum(map(name.count, BROAD))
    return wide, sum(letter.isupper() and letter not in BROAD for letter in name), broad


def _across(x: float, length: float, gap: float, wide: float) -> tuple[str, float, float]:
    """Return the anchor of a name so long that belongs to ``x``, where that is, and where the name begins."""
    if x + gap + length <= wide:
        return "start", x + gap, x + gap
    if x - gap - length >= -wide:
        return "end", x - gap, x - gap - length
    left = max(-wide, wide - length)
    return "start", left, left


def _covers(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
