"""Room for voxels in a file instead of in memory: of a long series only what is being worked on is held."""

from __future__ import annotations

import mmap
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from ronnaplan.portable import give_back, hold_singly, reserve

GIVEN_BACK_S: Final = 0.01
"""So often the pages that were touched are given back; those that are needed again come from the system's cache."""

AT_ONCE: Final = 8
"""So many slices are gone through at a time where threads share them: each hands the interpreter to the others when it
begins and takes it back when it ends, which for single slices takes as long as what is done with them."""


def one_by_one(voxels: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Yield the slices of ``voxels`` (K, J, I); of those that lie in a `Scratch` none is held when the next one comes.

    For who goes through all of a scan faster than its pages are given back by themselves.
    """
    for plane in voxels:
        yield plane
        let_go(voxels)


def runs(voxels: NDArray[Any], first: int, end: int) -> Iterator[tuple[int, int]]:
    """Yield first and past-the-last of runs of `AT_ONCE` slices of ``voxels`` (K, ...): ``first`` to before ``end``.

    Of those that lie in a `Scratch` none is held when the next ones come.
    """
    for start in range(first, end, AT_ONCE):
        yield start, min(start + AT_ONCE, end)
        let_go(voxels)


def let_go(voxels: NDArray[Any]) -> None:
    """Hold nothing of ``voxels`` (...) that lie in a `Scratch`, until they are touched again."""
    base: Any = voxels
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, mmap.mmap):
        give_back(base)


class Scratch:
    """A nameless file in a folder, that voxels lie in; it is gone with them, or with this process.

    Within the block what is touched of them is given back again and again, where the system offers that. The file's
    room is reserved at once where it can be, so that a disk that is full is noticed here.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._map: mmap.mmap | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._give_back, name="scratch", daemon=True)

    def take(self, count: int) -> mmap.mmap:
        """Return room for ``count`` bytes; raises `OSError` where the disk has none. Only the last is given back."""
        with tempfile.TemporaryFile(dir=self._folder) as file:
            reserve(file.fileno(), count)
            self._map = mmap.mmap(file.fileno(), count)
            hold_singly(self._map)
        return self._map

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        self._map = None

    def _give_back(self) -> None:
        while not self._over.wait(GIVEN_BACK_S):
            if self._map is not None:
                give_back(self._map)
