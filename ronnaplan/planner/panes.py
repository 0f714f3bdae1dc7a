"""How large the page shows each view, and with how many pixels a picture for it is drawn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ronnaplan.scene.names import Names, Room

EM_PIXELS = 12.0
"""Height of the letters, unless the page says otherwise, as it does on very large screens."""

TITLE_EM, TITLE_LINE_EM = 2.0, 1.5
"""Height of what a view's title of one line stands in, at its top, and of each further line, in letters' heights."""

TITLE_LETTER_EM, BESIDE_TITLE_PIXELS = 0.46, 34.0
"""How wide a title's letter is on average, most being small; and what a view's button and edges take of its lines."""

MOST_TITLE_LINES, MOST_TITLE_SHARE = 3, 0.34
"""A title that is longer is cut: so many lines, and so much of the view's height."""

EDGE_EM, EDGE_HIGH_EM = 1.1, 1.4
"""Half the width of a letter at an edge of a cut, and how high it stands, in heights of the letters."""

LEAST_PIXELS = 16
"""Of a side of a picture."""

MOST_STILL_PIXELS, MOST_MOVING_PIXELS = 4_000_000, 200_000
"""Of a picture at rest, with a pixel for each of the screen's; and while something moves, to follow the hand."""

GREATEST_RATIO = 4.0
"""No screen has more pixels to one of the page's."""


@dataclass(frozen=True)
class Pane:
    """A view of ``width`` x ``height`` pixels of the page, ``ratio`` of the screen each; letters are ``em`` high."""

    width: float = 448.0
    height: float = 448.0
    ratio: float = 1.0
    em: float = EM_PIXELS

    @property
    def halves(self) -> tuple[float, float]:
        """Half the width and half the height, in halves of the shorter side."""
        shorter = max(min(self.width, self.height), 1.0)
        return max(self.width, 1.0) / shorter, max(self.height, 1.0) / shorter

    def room(self, half: float, title: str = "") -> Room:
        """Return the room for names below a ``title``, in units of which ``half`` are half the shorter side."""
        wide, high = self.halves
        em = self.em * self.pixel(half)
        title_em = TITLE_EM + TITLE_LINE_EM * (self.title_lines(title) - 1)
        return Room(half * wide, half * high, em, title=title_em * em)

    def title_lines(self, title: str) -> int:
        """Return how many lines a title takes."""
        side, letters = self.width - BESIDE_TITLE_PIXELS, Room(1.0, 1.0, self.em, TITLE_LETTER_EM)
        lines, line = 1, ""
        for word in title.split():
            longer = f"{line} {word}".lstrip()
            fits = letters.length(longer) <= side or not line
            lines, line = (lines, longer) if fits else (lines + 1, word)
        most = int(MOST_TITLE_SHARE * self.height / (TITLE_LINE_EM * self.em))
        return max(1, min(lines, most, MOST_TITLE_LINES))

    def names(self, half: float, title: str, told: Iterable[dict[str, Any]] = ()) -> Names:
        """Return the writing of names over a cut, in the same units.

        None stands on the letters at its four edges, nor on what is ``told`` elsewhere (label, at, anchor).
        """
        room = self.room(half, title)
        wide, high = EDGE_EM * room.em, EDGE_HIGH_EM * room.em
        top, bottom = room.title - room.high, room.high - high
        middles = [(-wide, top, wide, top + high), (-wide, bottom, wide, room.high)]
        sides = [
            (-room.wide, -high / 2, 2 * wide - room.wide, high / 2),
            (room.wide - 2 * wide, -high / 2, room.wide, high / 2),
        ]
        places = ((one, *one["at"]) for one in told)
        written = [room.box(one["label"], x, y, one["anchor"]) for one, x, y in places]
        return Names(room, [*middles, *sides, *written])

    def pixel(self, half: float) -> float:
        """Return how wide a pixel of the page is, in the same units."""
        return 2 * half / max(min(self.width, self.height), 1.0)

    def shape(self, most_pixels: int) -> tuple[int, int]:
        """Return rows and columns of a picture with the screen's pixels, or with fewer where they are too many."""
        share = min(1.0, (most_pixels / max(self.width * self.height * self.ratio**2, 1.0)) ** 0.5) * self.ratio
        return max(LEAST_PIXELS, round(share * self.height)), max(LEAST_PIXELS, round(share * self.width))
