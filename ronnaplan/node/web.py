"""DICOMweb, and what its client passes over: answers and lists that are cut short, types with parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from email.message import Message
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from ronnaplan.errors import InputError

if TYPE_CHECKING:
    from requests import Response

    from ronnaplan.node.config import Peer

LONGEST_END: Final = 4096
"""Bytes at the end of an answer of several parts among which its last boundary is looked for."""
MORE: Final = "299"
"""Code of the warning that a list has more than was told (PS3.18, 8.3.4.4)."""


class Heard:
    """What an archive said beside its last answer."""

    def __init__(self) -> None:
        self.status = 0
        self.has_more = False
        """Whether its list was cut short."""

    def hear(self, response: Response, **_: Any) -> None:
        """Take note of an answer, and have it raise `InputError` where it ends before its last boundary."""
        self.status = response.status_code
        self.has_more = MORE in response.headers.get("Warning", "").split()
        head = Message()
        head["Content-Type"] = response.headers.get("Content-Type", "")
        if head.get_content_maintype() == "multipart" and (boundary := head.get_boundary()):
            end = f"--{boundary}--".encode()
            response.iter_content = partial(_whole, response.iter_content, end)  # type: ignore[method-assign]
        elif head.get_content_maintype() == "application":  # the client knows no parameters, such as a charset
            response.headers["Content-Type"] = head.get_content_type()


def web_client(peer: Peer, silent_s: float) -> tuple[Any, Heard]:
    """Return a client of a peer's DICOMweb that waits no longer for any of it, and what the peer says beside."""
    from dicomweb_client.api import DICOMwebClient

    heard = Heard()
    return DICOMwebClient(str(peer.url), callback=heard.hear, timeout=silent_s), heard


def _whole(chunks: Callable[..., Iterator[bytes]], end: bytes, *given: Any, **named: Any) -> Iterator[bytes]:
    last = b""
    for chunk in chunks(*given, **named):
        last = (last + chunk)[-LONGEST_END:]
        yield chunk
    if end not in last:
        raise InputError("an answer by DICOMweb was cut short; fetch it again")
