"""Where a case's planner is reached, kept with the case: a page that is open finds it when it is started again."""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from ronnaplan.documents.fields import DocumentModel
from ronnaplan.documents.files import read_json
from ronnaplan.documents.reading import to_json, validated
from ronnaplan.errors import InputError
from ronnaplan.portable import is_own_secret

ADDRESS_FILE = ".planner-address.json"
"""Lies in the folder of a case, and in that of a start page."""

TOKEN_BYTES = 24
ANYBODY_WRITES = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH
GREATEST_PORT = 65_535


class _Kept(DocumentModel):
    """The file: port and token of the planner of this case."""

    port: Annotated[int, Field(ge=1, le=GREATEST_PORT)]
    token: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{32}$")]


@dataclass(frozen=True)
class Address:
    """A port (0 for any that is free), the token that lets a browser in, and whether both are to be kept."""

    port: int
    token: str
    lasting: bool = True

    @classmethod
    def new(cls, port: int = 0, lasting: bool = True) -> Address:
        """Return an address that nobody knows yet."""
        return cls(port, secrets.token_urlsafe(TOKEN_BYTES), lasting)


def address_for(file: Path, host: str, port: int = 0) -> Address:
    """Return the address kept in ``file``, a new one where there is none, and where its port is in use one for now.

    ``port`` is the one that was asked for, 0 for none. A file that others can read or that another user wrote is not
    believed: who knows the token can plan.
    """
    kept = _read(file)
    if kept is None:
        return Address.new(port)
    if not _is_free(host, kept.port):  # by another planner of this case, perhaps: what it kept stays
        return Address.new(port, lasting=False)
    return kept if port in (0, kept.port) else Address.new(port)


def keep(file: Path, address: Address) -> None:
    """Write a lasting address so that only this user can read it; where that cannot be, it is not kept.

    A folder that nobody is to write into is left alone, by root too, whom no mode holds up.
    """
    if not address.lasting:
        return
    with contextlib.suppress(OSError):
        if not file.parent.stat().st_mode & ANYBODY_WRITES:
            return
        file.unlink(missing_ok=True)
        with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
            stream.write(to_json(_Kept(port=address.port, token=address.token)))


@contextlib.contextmanager
def needed_place(host: str, port: int) -> Iterator[None]:
    """Raise `InputError` where what is done cannot listen at this place."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot listen on {host}:{port} ({error.strerror}); choose another --port") from error


def _read(file: Path) -> Address | None:
    try:
        status = file.lstat()
        if not stat.S_ISREG(status.st_mode) or not is_own_secret(status):
            return None
        kept = validated(read_json(file), _Kept, str(file), "it is not used")
    except (InputError, OSError):
        return None
    return Address(kept.port, kept.token)


def _is_free(host: str, port: int) -> bool:
    try:
        family, *_, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family) as one:
            if os.name == "posix":  # as aiohttp does: a port whose last connections are fading counts as free
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            one.bind(place)
    except OSError:
        return False
    return True
