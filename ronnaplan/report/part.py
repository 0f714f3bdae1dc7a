"""One part of the report: its HTML, and the warnings that go to the top of the page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

Piece = str | Callable[[], str]
"""A piece of HTML, or what draws it when the page is written: then the scan may be gone."""


def html_of(pieces: Iterable[Piece]) -> list[str]:
    """Return the HTML of pieces, drawn now."""
    return [piece if isinstance(piece, str) else piece() for piece in pieces]


@dataclass(frozen=True)
class Part:
    """A titled part; ``body`` holds pieces and may be empty, ``warnings`` are texts."""

    title: str
    body: Sequence[Piece] = ()
    warnings: list[str] = field(default_factory=list)
