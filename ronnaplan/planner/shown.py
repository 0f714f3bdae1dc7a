"""What one open page shows, by name: what changed is sent to it, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

Send = Callable[[dict[str, Any]], None]

OWN: Final = {
    "tab": "paths",
    "show_rejected": False,
    "diameter": 0.0,
    "marker_count": "6",  # as what is typed: a number of the page counts as one with a fraction
    "message": "",
    "sorted_by": "number",
    "falling": False,
}
"""What a page may set itself, and as what it begins."""


class Shown:
    """Values of one page; `flush` sends those that the page does not have."""

    def __init__(self, send: Send) -> None:
        self.send = send
        self._now: dict[str, Any] = {}
        self._unsent: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        return self._now[name]

    def __setitem__(self, name: str, value: Any) -> None:
        if name not in self._now or self._now[name] != value:
            self._now[name] = self._unsent[name] = value

    def update(self, values: Mapping[str, Any]) -> None:
        """Set several."""
        for name, value in values.items():
            self[name] = value

    def take(self, changes: Iterable[Mapping[str, Any]]) -> None:
        """Take over what the page set itself, where it may."""
        for change in changes:
            if change["key"] in OWN:
                self._now[change["key"]] = change.get("value")
                self._unsent.pop(change["key"], None)

    def flush(self) -> None:
        """Send what the page does not have."""
        if self._unsent:
            self.send(self._unsent)
            self._unsent = {}

    def whole(self) -> dict[str, Any]:
        """Return all, for a page that begins; nothing is left to be sent then."""
        self._unsent = {}
        return dict(self._now)
