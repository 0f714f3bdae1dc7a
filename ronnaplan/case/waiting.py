"""The change that could not be written, as on a full disk: it waits until it can be, or is given up."""

from __future__ import annotations

from collections.abc import Callable

from ronnaplan.errors import UnwrittenError


class Waiting:
    """Keeps one change: none that waits is dropped for a later one, which is made to what is shown, without it."""

    def __init__(self) -> None:
        self._make: Callable[[], None] | None = None

    def __bool__(self) -> bool:
        """Whether a change waits."""
        return self._make is not None

    def keep(self, error: UnwrittenError, make: Callable[[], None]) -> None:
        """Let a change wait that ``make`` makes; raises `UnwrittenError` where another one waits."""
        if self._make is not None:
            raise UnwrittenError(
                f"{error}; this change is not made, as one before it still waits to be written: "
                "let that be written, or give it up first"
            ) from error
        self._make = make

    def make(self) -> bool:
        """Make the change that waits, if there is one; return whether it was made.

        Raises `UnwrittenError`, and it waits on, where it still cannot be written; what else is wrong with it ends it.
        """
        make, self._make = self._make, None
        if make is not None:
            make()
        return make is not None

    def give_up(self) -> None:
        """Do without the change that waits."""
        self._make = None
