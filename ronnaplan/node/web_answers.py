"""What a DICOMweb archive answers, as it comes: bounded, and without what the client of DICOMweb cannot read."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from email.message import Message
from typing import TYPE_CHECKING, Any, Final

from ronnaplan.ct.limits import MIB
from ronnaplan.errors import InputError
from ronnaplan.text import printable

if TYPE_CHECKING:
    from requests import Response
    from urllib3 import HTTPResponse

PIECE_BYTES: Final = 1 << 18
LONGEST_BESIDE: Final = 4096
"""Bytes before the first part of an answer of several parts, and after the last (RFC 2046: preamble, epilogue)."""
LONGEST_LIST: Final = 128 * MIB
"""Of an answer that is no instance: a hundred thousand matches of a kilobyte each."""
PATIENCE_S: Final = 600.0
LEAST_BYTES_PER_S: Final = 1000
"""An answer may take `PATIENCE_S`, and a second more for so many bytes of it."""
MORE: Final = "299"
"""Code of the warning that a list has more than was told (PS3.18, 8.3.4.4)."""


class Heard:
    """What the archive ``name`` said beside its last answer; bounds what it answers."""

    def __init__(self, name: str, largest_instance_mib: int) -> None:
        self._name, self._largest_bytes = name, largest_instance_mib * MIB
        self.status = 0
        self.has_more = False
        """Whether its list was cut short."""

    def hear(self, response: Response, **_: Any) -> None:
        """Take note of an answer, and have it raise `InputError` where it never ends, or before its last boundary."""
        self.status = response.status_code
        self.has_more = MORE in response.headers.get("Warning", "").split()
        head = Message()
        head["Content-Type"] = response.headers.get("Content-Type", "")
        self._require_instances(response)
        pieces = _pieces(response.raw, self._name)  # not the response, which would lie in a circle with it
        if head.get_content_maintype() == "multipart" and (boundary := head.get_boundary()):
            pieces = _from_first(pieces, f"--{boundary}".encode(), self._name)
            pieces = _to_last(pieces, f"--{boundary}".encode(), self._largest_bytes, self._name)
        else:
            is_instance = head.get_content_type() == "application/dicom"
            pieces = _within(pieces, self._largest_bytes if is_instance else LONGEST_LIST, self._name)
            if head.get_content_maintype() == "application":  # the client knows no parameters, such as a charset
                response.headers["Content-Type"] = head.get_content_type()
        ended = _ended(pieces, response.raw)
        response.iter_content = lambda *_, **__: ended  # type: ignore[method-assign]

    def _require_instances(self, response: Response) -> None:
        """Raise `InputError` for an answer of nothing to who asked for instances, as 204 is."""
        asked = str(response.request.headers.get("Accept", "")).startswith("multipart/")
        if asked and response.ok and not response.is_redirect and not response.headers.get("Content-Type"):
            response.close()
            said = printable(f"{response.status_code} {response.reason or ''}".strip())
            raise InputError(
                f"{self._name} answered {said} in place of the instances that were asked for; see whether it has them"
            )


def _pieces(raw: HTTPResponse, archive: str) -> Iterator[bytes]:
    """Yield an answer as it comes; raises `InputError` once it takes longer than any should."""
    from requests import ConnectionError as GoneError
    from urllib3.exceptions import HTTPError

    begun, count = time.monotonic(), 0
    try:
        while piece := raw.read1(PIECE_BYTES, decode_content=True):
            count += len(piece)
            if time.monotonic() - begun > PATIENCE_S + count / LEAST_BYTES_PER_S:
                raise InputError(
                    f"{archive} sent {count} bytes by DICOMweb in {time.monotonic() - begun:.0f} s; ask again when it "
                    "is less busy"
                )
            yield piece
    except HTTPError as error:
        raise GoneError(error) from error


def _ended(pieces: Iterator[bytes], raw: HTTPResponse) -> Iterator[bytes]:
    """Yield all of them, and end the connection: of an answer that is given up nothing more is awaited."""
    try:
        yield from pieces
    finally:
        raw.close()


def _within(pieces: Iterator[bytes], most: int, archive: str) -> Iterator[bytes]:
    """Yield an answer of one part; raises `InputError` where it is longer than ``most`` bytes."""
    count = 0
    for piece in pieces:
        count += len(piece)
        _require_end(count, most, archive)
        yield piece


def _from_first(pieces: Iterator[bytes], boundary: bytes, archive: str) -> Iterator[bytes]:
    """Yield an answer of several parts from its first boundary on; raises `InputError` where that is none."""
    line = re.compile(rb"(?:\A|(?<=\n))" + re.escape(boundary) + rb"(--|[ \t]*\r?\n)")
    head = b""
    for piece in pieces:
        head += piece
        found = line.search(head)
        if found is not None:
            if found[1] in (b"--", b"\n"):
                told = "no part" if found[1] == b"--" else "lines that end in LF alone"
                raise InputError(f"{archive} sent {told} by DICOMweb; expected parts with lines that end in CR LF")
            yield head[found.start() :]
            yield from pieces
            return
        if len(head) > LONGEST_BESIDE + len(boundary):
            raise InputError(
                f"{archive} sent parts by DICOMweb without the boundary that it states; check its address"
            )
    raise _cut_short(archive)


def _to_last(pieces: Iterator[bytes], boundary: bytes, most: int, archive: str) -> Iterator[bytes]:
    """Yield an answer of parts of up to ``most`` bytes; raises `InputError` where one is longer, or the end lacks."""
    last, count = b"", 0
    for piece in pieces:
        last += piece
        count = 0 if boundary in last else count + len(piece)
        _require_end(count, most, archive)
        last = last[-LONGEST_BESIDE - len(boundary) :]
        yield piece
    if boundary + b"--" not in last:
        raise _cut_short(archive)


def _require_end(count: int, most: int, archive: str) -> None:
    if count > most:
        raise InputError(
            f"{archive} sent more than {most // MIB} MiB in one piece by DICOMweb; ask it for less, or raise "
            "'largest_instance_mib' in [limits] for an instance that is larger"
        )


def _cut_short(archive: str) -> InputError:
    return InputError(f"{archive} sent an answer by DICOMweb that was cut short; fetch it again")
