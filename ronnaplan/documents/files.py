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
    """Write ``data`` to ``path``, replacing what was there whole: written beside, then renamed.

    A link is followed, so that what it points to is replaced and not the link. Raises `InputError` for a place
    that cannot be written and for anything but a regular file (a device, a pipe).
    """
    target = Path(os.path.realpath(path))
    content = data.encode() if isinstance(data, str) else data
    check_target(path)
    try:
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=".ronnaplan.")
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


def check_target(path: str | os.PathLike[str]) -> None:
    """Raise `InputError` unless a file can be written at ``path``: worth knowing before a long computation."""
    if not os.fspath(path):
        raise InputError("an empty name was given for the file to write; give its path")
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise InputError(f"{os.fspath(path)} is no regular file; give the path of a file to write")
    if not target.parent.is_dir():
        raise InputError(
            f"cannot write {os.fspath(path)}: the folder {target.parent} does not exist; make it first"
        )


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_result(path: str | None, text: str) -> None:
    """Write ``text`` to the file named by ``-o``, or to standard output when there is none."""
    if path is not None:
        write_atomically(path, text)
        return
    if sys.stdout is None:
        raise InputError("standard output is closed; name a file with -o")
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        discard_output()
        raise InputError(f"cannot write to standard output: {error.strerror}; name a file with -o") from error


def discard_output() -> None:
    """Send what is still to be written to standard output nowhere, so that leaving does not fail once more."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def read_json(path: str | os.PathLike[str]) -> Any:
    """Parse the JSON file at ``path``; raises `InputError` when it is missing, too large or not JSON."""
    source = Path(path)
    try:
        if not source.is_file():
            reason = "it is no regular file" if source.exists() else "there is no such file"
            raise InputError(f"cannot read {source}: {reason}; give the path of a JSON document")
        with source.open("rb") as stream:
            content = stream.read(MAX_DOCUMENT_BYTES + 1)
        if len(content) > MAX_DOCUMENT_BYTES:
            raise InputError(f"{source} is larger than {MAX_DOCUMENT_BYTES} bytes; expected a JSON document")
        document = json.loads(content)
        json.dumps(document, ensure_ascii=False).encode()
    except OSError as error:
        raise InputError(f"cannot read {source}: {error.strerror}; give the path of a JSON document") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source} is not a JSON document ({error}); give a file that ronnaplan wrote") from error
    return document


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Return the folder at ``path``, made if it is not there; raises `InputError` where it cannot be."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}; choose another place") from error
    return folder
