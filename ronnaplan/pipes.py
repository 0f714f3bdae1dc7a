"""From one process of this program to another: where it finds the program, and things, arrays as they lie in memory."""

from __future__ import annotations

import os
import pickle
import struct
from pathlib import Path
from typing import IO, Any, Final

SIZE: Final = struct.Struct("<Q")
"""Before every piece that goes from one process to the other: how many bytes it has."""


class Sendable:
    """What `send` may write while another thread has it find a value that it keeps (`functools.cached_property`)."""

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__.copy()  # at once: what grows while it is gone through cannot be written


def environment() -> dict[str, str]:
    """Return the environment in which another process finds this very package, wherever it is begun.

    What it says is UTF-8, on Windows too, where it would take the letters of a region.
    """
    here = str(Path(__file__).resolve().parents[1])
    paths = os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH")]))
    # -m would look in the folder where it is begun first, which may hold another copy of the source
    return {**os.environ, "PYTHONPATH": paths, "PYTHONSAFEPATH": "1", "PYTHONIOENCODING": "utf-8"}


def send(stream: IO[bytes], thing: Any) -> None:
    """Write a thing for `receive`; arrays go as they lie in memory, without a copy of them."""
    arrays: list[pickle.PickleBuffer] = []
    text = pickle.dumps(thing, protocol=5, buffer_callback=arrays.append)
    stream.write(SIZE.pack(len(arrays)))
    for piece in (memoryview(text), *(one.raw() for one in arrays)):
        stream.write(SIZE.pack(piece.nbytes))
        stream.write(piece)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Return a thing that `send` wrote; raises `EOFError` where there is none."""
    (count,) = SIZE.unpack(_read(stream, SIZE.size))
    text, *arrays = (_read(stream, SIZE.unpack(_read(stream, SIZE.size))[0]) for _ in range(count + 1))
    return pickle.loads(text, buffers=arrays)


def _read(stream: IO[bytes], size: int) -> bytearray:
    piece = bytearray(size)
    view, got = memoryview(piece), 0
    while got < size:
        more = stream.readinto(view[got:])  # type: ignore[attr-defined]
        if not more:
            raise EOFError
        got += more
    return piece
