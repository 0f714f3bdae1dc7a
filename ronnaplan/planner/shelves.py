"""An archive on the start page: its series are listed with pictures, and one is fetched.

Who talks to the archive is handed in.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from aiohttp import web
from numpy.typing import NDArray

from ronnaplan.errors import RonnaplanError, UsageError

Result = TypeVar("Result")
Thing = TypeVar("Thing")


class Shelf(Protocol):
    """What an archive has; it raises `RonnaplanError` where that cannot be had."""

    @property
    def name(self) -> str:
        """What the archive is called."""
        ...

    def look(self, patient_id: str, date: str) -> list[dict[str, Any]]:
        """List series, each with what the page shows of it; their numbers hold until the next time."""
        ...

    def picture(self, number: int) -> NDArray[np.uint8] | None:
        """Return a small picture (J, I) of a series that was listed, None where there is none."""
        ...

    def fetch(self, number: int, folder: Path) -> None:
        """Bring a series that was listed."""
        ...


def keyed(
    things: Iterable[Thing], rows: Iterable[dict[str, Any]]
) -> tuple[dict[str, Thing], list[dict[str, Any]]]:
    """Return ``things`` by keys, and their rows with these.

    Keys are of their own each time, so that what another tab looked for since is not taken in a thing's place.
    """
    by_key = {secrets.token_hex(8): thing for thing in things}
    return by_key, [{"key": key, **row} for key, row in zip(by_key, rows, strict=True)]


class Shelves:
    """Asks a shelf, if there is one, for one thing at a time; pictures wait for nobody's fetching or looking."""

    def __init__(self, shelf: Shelf | None) -> None:
        self._shelf, self._one_by_one, self._turn = shelf, asyncio.Lock(), 0
        self._numbers: dict[str, int] = {}

    async def look(self, request: web.Request) -> Any:
        """Tell the archive's name, and what it has of a patient or of days where they are named."""
        if self._shelf is None:
            return {"name": ""}
        patient, date = request.query.get("patient", "").strip(), request.query.get("date", "")
        if not patient and not date:
            return {"name": self._shelf.name}
        shelf = self._shelf
        found = await self._next(lambda: shelf.look(patient, date))
        self._numbers, series = keyed(range(len(found)), found)
        return {"name": shelf.name, "series": series}

    async def picture(self, request: web.Request) -> NDArray[np.uint8] | None:
        """Return a picture of a series; None where there is none, or something else was asked for meanwhile."""
        key, shelf, turn = request.match_info["key"], self._shelf, self._turn
        if shelf is None:
            return None
        async with self._one_by_one:
            number = self._numbers.get(key)
            if number is None or turn != self._turn:
                return None
            try:
                return await asyncio.get_running_loop().run_in_executor(None, lambda: shelf.picture(number))
            except RonnaplanError:
                return None

    async def fetch(self, request: web.Request, folder: Path) -> None:
        """Bring a series that was listed into a folder; raises `RonnaplanError` where it does not come whole."""
        key, shelf = request.query.get("key", ""), self._shelf

        def bring() -> None:
            number = self._numbers.get(key)  # only now: a look that was under way listed others meanwhile
            if shelf is None or number is None:
                raise UsageError("that series of an archive is no longer listed; look for it again")
            shelf.fetch(number, folder)

        await self._next(bring)

    async def _next(self, work: Callable[[], Result]) -> Result:
        """Do what matters more than the pictures that still wait."""
        self._turn += 1
        async with self._one_by_one:
            return await asyncio.get_running_loop().run_in_executor(None, work)
