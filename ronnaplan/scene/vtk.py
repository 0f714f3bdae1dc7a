"""Asks a process of its own to do what VTK does (`ronnaplan.scene.workshop`)."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.errors import InputError

Arrays = dict[str, NDArray[Any]]

LONGEST_S = 300.0
"""A task that takes longer is given up."""

NEEDED = "pyvista"


class NoGraphicsError(InputError):
    """VTK could not do a task, for want of a graphics library, say."""


def asked(task: str, arrays: Arrays) -> Arrays:
    """Return the answer to a task of the workshop.

    Raises `InputError` where pyvista is not installed, `NoGraphicsError` where the task could not be done.
    """
    if find_spec(NEEDED) is None:
        raise InputError(f"3-D surfaces need {NEEDED}; install ronnaplan[scene]")
    stream = io.BytesIO()
    save_arrays(stream, {"task": np.array(task), **arrays})
    try:
        done = subprocess.run(
            [sys.executable, "-m", "ronnaplan.scene.workshop"],
            input=stream.getbuffer(),
            capture_output=True,
            timeout=LONGEST_S,
            check=True,
            env=_environment(),
        )
    except subprocess.CalledProcessError as error:
        last = error.stderr.decode(errors="replace").strip().rpartition("\n")[2] or f"status {error.returncode}"
        raise NoGraphicsError(f"VTK could not make {task} ({last}); see docs/planner.md, 3-D") from error
    except subprocess.TimeoutExpired as error:
        raise NoGraphicsError(
            f"VTK was not done with {task} after {LONGEST_S:g} s; give it a smaller scan"
        ) from error
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as answer:
        return dict(answer)


def save_arrays(stream: IO[bytes], arrays: Arrays) -> None:
    """Write arrays by name; `numpy.load` reads them."""
    named: dict[str, Any] = {**arrays}
    np.savez(stream, **named)


def _environment() -> dict[str, str]:
    """Return the environment in which the other process finds this very package."""
    here = str(Path(__file__).resolve().parents[2])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH")]))}
