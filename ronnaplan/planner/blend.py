"""How a second image is shown over the cuts of the first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ronnaplan.errors import UsageError

MODES: Final = ("blend", "checkerboard")


@dataclass(frozen=True)
class Blend:
    """So much of the second image (0 to 1), over all of the first or in every other square."""

    share: float = 0.5
    mode: str = MODES[0]

    def __post_init__(self) -> None:
        """Refuse a mode that there is not."""
        if self.mode not in MODES:
            raise UsageError(f"images are not shown as {self.mode}; they are as {', '.join(MODES)}")
