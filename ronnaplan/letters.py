"""Names in pictures as they are written: by fonts that have their letters, and never taken for formulas."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager, get_font
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FixedLocator

FONT = "DejaVu Sans"
"""The font of a picture's texts, which matplotlib brings along."""
WEIGHT = 400
"""Of letters that another font draws: few come in a bold one, and matplotlib would complain."""
NO_LETTER = "\u25a1"
"""Stands for a letter that no font here has."""
LAST_RESORT = "Last Resort"
"""How fonts are called whose every letter is a box."""


def written_out(figure: Figure) -> None:
    """Have every text of ``figure`` drawn by the letter.

    Other installed fonts draw what `FONT` lacks, a box stands for what none has, and what is between two dollar signs
    is no formula.
    """
    drawn = list(_drawn(figure))
    texts = [one for one in drawn if isinstance(one, Text) and one.get_text()]
    wanting = frozenset(letter for text in texts for letter in text.get_text() if letter.isprintable()) - _letters(
        FONT
    )
    fonts = list(_fonts_for(wanting)) if wanting else []
    boxes = str.maketrans(dict.fromkeys(wanting.difference(*map(_letters, fonts)), NO_LETTER))
    for text in texts:
        text.set_parse_math(False)
        if wanting.intersection(text.get_text()):
            text.set(fontfamily=[*text.get_fontfamily(), *fonts], fontweight=WEIGHT)
            text.set_text(text.get_text().translate(boxes))
    for axis in drawn if boxes else ():
        if isinstance(axis, Axis):
            _box_ticks(axis, boxes)


def _box_ticks(axis: Axis, boxes: dict[int, str]) -> None:
    """Have an axis that names its ticks name them so: it sets their texts again where it is drawn."""
    names = [text.get_text() for text in axis.get_majorticklabels()]
    boxed = [name.translate(boxes) for name in names]
    if boxed != names:
        axis.set_major_locator(FixedLocator(axis.get_majorticklocs().tolist()))
        axis.set_major_formatter(FixedFormatter(boxed))


def _drawn(artist: Artist) -> Iterator[Artist]:
    """Yield what may be drawn: ticks of an axis that is not shown take longer to make than all else."""
    yield artist
    for child in artist.get_children():
        if not (isinstance(child, Axis) and isinstance(artist, Axes) and not artist.axison):
            yield from _drawn(child)


def _fonts_for(letters: frozenset[str]) -> Iterator[str]:
    """Yield fonts, each the one that has the most of the letters that are left, until none has any."""
    upright = (font for font in fontManager.ttflist if font.style == "normal" and font.weight == WEIGHT)
    names = sorted({font.name for font in upright if not font.name.startswith(LAST_RESORT)})
    while letters and (best := max(names, key=lambda name: len(letters & _letters(name)))):
        left = letters - _letters(best)
        if left == letters:
            return
        yield best
        letters = left


@cache
def _letters(name: str) -> frozenset[str]:
    """Return the letters of a font; none of one that cannot be read."""
    try:
        path = next(font.fname for font in fontManager.ttflist if font.name == name)
        return frozenset(map(chr, get_font(path).get_charmap()))
    except (OSError, RuntimeError):
        return frozenset()
