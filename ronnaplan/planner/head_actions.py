"""What the page may ask of the 3-D view: as what the head is drawn, how dense, and what is taken away."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ronnaplan.errors import UsageError
from ronnaplan.planner.arguments import Strength
from ronnaplan.planner.painter import Painter
from ronnaplan.planner.state import PlannerState
from ronnaplan.scene.volume import PRESETS


class HeadActions:
    """The page's actions on how the head is seen."""

    def __init__(self, state: PlannerState, painter: Painter) -> None:
        self._state, self._painter = state, painter

    def by_name(self) -> dict[str, Callable[..., Any]]:
        """Return the actions."""
        return {
            "pictures": self._send_pictures,
            "drawn_here": self._send_things,
            "open_head": self._open_head,
            "show_as": self._show_as,
            "strength": self._set_strength,
            "volume_is_slow": self._volume_is_slow,
        }

    def _send_pictures(self) -> None:
        """A page cannot draw in 3-D itself: it is sent pictures until it can."""
        self._painter.pictures = True
        self._state.look.open_head("")
        self._state.look.show_as(self._state.look.surface)

    def _send_things(self) -> None:
        """A page that was too slow to draw in 3-D itself does so now."""
        self._painter.pictures = False

    def _open_head(self, name: str) -> None:
        """Take a part of the head before the crosshair away, or put it back."""
        if name and self._painter.pictures:
            raise UsageError("this browser draws no 3-D itself; the head is not opened in pictures")
        self._state.look.open_head(name)

    def _show_as(self, name: str) -> None:
        """Draw the head as a surface, or whole."""
        if name in PRESETS and self._painter.pictures:
            raise UsageError("this browser draws no 3-D itself; in pictures the head is drawn as skin or skull")
        self._state.look.show_as(name)

    def _set_strength(self, strength: Strength) -> None:
        self._state.look.strength = strength

    def _volume_is_slow(self) -> None:
        """A page draws the whole scan too slowly: it is drawn as a surface."""
        self._state.look.show_as(self._state.look.surface)
        self._painter.shown["news"] = "the whole scan is drawn too slowly here; its surface is shown"
