"""One part of the report: its HTML, and the warnings that go to the top of the page."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Part:
    """A titled part; ``body`` holds pieces of HTML and may be empty, ``warnings`` are texts."""

    title: str
    body: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
