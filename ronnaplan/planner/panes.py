"""How large the page shows each view, and with how many pixels a picture for it is drawn."""

from __future__ import annotations

from dataclasses import dataclass

from ronnaplan.scene.names import Names, Room

EM_PIXELS = 12.0
"""Height of the letters, unless the page says otherwise, as it does on very large screens."""

TITLE_EM = 2.0
"""Height of what a view's title stands in, at its top, in heights of the letters."""

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

    def room(self, half: float) -> Room:
        """Return the room for names, in units of which ``half`` are half the shorter side."""
        wide, high = self.halves
        em = self.em * self.pixel(half)
        return Room(half * wide, half * high, em, title=TITLE_EM * em)

    def names(self, half: float) -> Names:
        """Return the writing of names over a cut, in the same units: none on the letters at its four edges."""
        room = self.room(half)
        wide, high = EDGE_EM * room.em, EDGE_HIGH_EM * room.em
        top, bottom = room.title - room.high, room.high - high
        middles = [(-wide, top, wide, top + high), (-wide, bottom, wide, room.high)]
        sides = [
            (-room.wide, -high / 2, 2 * wide - room.wide, high / 2),
            (room.wide - 2 * wide, -high / 2, room.wide, high / 2),
        ]
        return Names(room, [*middles, *sides])

    def pixel(self, half: float) -> float:
        """Return how wide a pixel of the page is, in the same units."""
        return 2 * half / max(min(self.width, self.height), 1.0)

    def shape(self, most_pixels: int) -> tuple[int, int]:
        """Return rows and columns of a picture with the screen's pixels, or with fewer where they are too many."""
        share = min(1.0, (most_pixels / max(self.width * self.height * self.ratio**2, 1.0)) ** 0.5) * self.ratio
        return max(LEAST_PIXELS, round(share * self.height)), max(LEAST_PIXELS, round(share * self.width))
