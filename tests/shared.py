"""What takes long to make is made once a run: the workers of pytest-xdist read it from one file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from numpy.typing import NDArray

_folders: list[Path] = []


def share(config: pytest.Config) -> None:
    """In a worker, keep the files in the folder of the whole run, which pytest clears away with its others."""
    if hasattr(config, "workerinput"):
        _folders[:] = [Path(config.getoption("basetemp")).parent]


def once(name: str, make: Callable[[], NDArray[np.int16]]) -> NDArray[np.int16]:
    """Return what ``make`` makes; another worker that asks for the same ``name`` waits and reads it."""
    if not _folders:
        return make()
    path = _folders[0] / f"{name}.npy"
    with FileLock(path.with_suffix(".lock")):
        if not path.exists():
            partial = path.with_suffix(".partial.npy")
            np.save(partial, make())
            partial.replace(path)
    kept: NDArray[np.int16] = np.load(path)
    return kept
