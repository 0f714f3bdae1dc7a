"""Writing and reading of small text files: whole or not at all, and never a traceback for a bad one."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from ronnaplan.errors import InputError

MAX_DOCUMENT_BYTES = 64 * 2**20
"""Documents are a few kilobytes; a larger file is something else."""


def write_atomically(path: str | os.PathLike[str], data: str | bytes) -> None:
    """Write ``data`` to ``path``, replacing what was there whole: written beside, then renamed."""
    target = Path(path)
    content = data.encode() if isinstance(data, str) else data
    try:
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror}; choose another place") from error
    beside = Path(name)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        beside.chmod(0o666 & ~_umask())
        beside.replace(target)
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror}; choose another place") from error
    finally:
        beside.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_result(path: str | None, text: str) -> None:
    """Write ``text`` to the file named by ``-o``, or to standard output when there is none."""
    if path is None:
        sys.stdout.write(text)
    else:
        write_atomically(path, text)


def read_json(path: str | os.PathLike[str]) -> Any:
    """Parse the JSON file at ``path``; raises `InputError` when it is missing, too large or not JSON."""
    source = Path(path)
    try:
        if source.stat().st_size > MAX_DOCUMENT_BYTES:
            raise InputError(f"{source} is larger than {MAX_DOCUMENT_BYTES} bytes; expected a JSON document")
        return json.loads(source.read_bytes())
    except OSError as error:
        raise InputError(f"cannot read {source}: {error.strerror}; give the path of a JSON document") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source} is not a JSON document ({error}); give a file that ronnaplan wrote") from error


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Return the folder at ``path``, made if it is not there; raises `InputError` where it cannot be."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}; choose another place") from error
    return folder
