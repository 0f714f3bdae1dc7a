"""DICOMweb, and what its client passes over: answers and lists that are cut short, types with parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from email.message import Message
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from ronnaplan.errors import InputError

if TYPE_CHECKING:
    from pydicom.dataset import Dataset
    from requests import Response
    from urllib3.util import Retry

    from ronnaplan.node.config import Peer

LONGEST_END: Final = 4096
"""Bytes at the end of an answer of several parts among which its last boundary is looked for."""
AGAIN: Final = 4
"""So often an archive that is busy is asked again: at once, and after 2, 4 and 8 s more."""
BUSY: Final = (408, 429, 503, 504)
CONFLICT: Final = 409
"""Status of an archive that stored none of what it was sent."""
AS_STORED: Final = (("application/dicom", "*"),)
"""Instances in whichever transfer syntax an archive has them: it changes them by default, or fails where it cannot."""
UNACCEPTABLE: Final = (400, 406)
"""Status of an archive that does not know that it may be asked for them so."""
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
    from requests import Session
    from requests.adapters import HTTPAdapter

    heard, session = Heard(), Session()
    for scheme in ("http://", "https://"):
        session.mount(scheme, HTTPAdapter(max_retries=_patience()))
    client = DICOMwebClient(str(peer.url), session=session, callback=heard.hear, timeout=silent_s)
    client.set_http_retry_params(retry=False)  # it tries again whatever happened, also where nobody is there
    return client, heard


def unreached(peer: Peer, error: Exception) -> InputError:
    """Return what there is to say of a peer whose DICOMweb raised ``error``."""
    from requests import HTTPError, JSONDecodeError, Timeout

    if isinstance(error, JSONDecodeError):
        return InputError(f"{peer.name} answered by DICOMweb what is no JSON; check its address")
    if isinstance(error, HTTPError) and error.response is not None:
        said = f"{error.response.status_code} {error.response.reason or ''}".strip()
        return InputError(f"{peer.name} answered {said} by DICOMweb; check its address, or ask again later")
    told = "it does not answer" if isinstance(error, Timeout) else _innermost(error)
    return InputError(f"{peer.name} cannot be reached by DICOMweb: {told}; check its address")


def is_unacceptable(error: Exception) -> bool:
    """Whether an archive may give in its own transfer syntax what it did not give as it is stored."""
    from requests import HTTPError

    return (
        isinstance(error, HTTPError) and error.response is not None and error.response.status_code in UNACCEPTABLE
    )


def refusals(error: Exception) -> Dataset | None:
    """Return what an archive says of instances none of which it stored (PS3.18, 10.5.3: 409); None where it says none.

    The client raises an error for such an answer, whatever it says.
    """
    from pydicom.dataset import Dataset
    from requests import HTTPError

    if not isinstance(error, HTTPError) or error.response is None or error.response.status_code != CONFLICT:
        return None
    try:
        said = Dataset.from_json(error.response.text)
    except Exception:  # pydicom raises many kinds for what is no data set
        return None
    return said if said.get("FailedSOPSequence") else None


def _innermost(error: BaseException) -> str:
    """Return what the system said, without what the libraries on the way have made of it."""
    said, seen = str(error), error
    while (cause := seen.__cause__ or seen.__context__) is not None:
        seen = cause
        if isinstance(seen, OSError) and seen.strerror:
            said = f"{seen.strerror[:1].lower()}{seen.strerror[1:]}"
    return said


def _patience() -> Retry:
    """Return how often an archive that is busy is asked again; what cannot be connected is told at once."""
    from urllib3.util import Retry

    return Retry(
        AGAIN,
        connect=0,
        read=0,
        status_forcelist=BUSY,
        allowed_methods=("GET",),
        backoff_factor=1.0,
        respect_retry_after_header=False,
        raise_on_status=False,
    )


def _whole(chunks: Callable[..., Iterator[bytes]], end: bytes, *given: Any, **named: Any) -> Iterator[bytes]:
    last = b""
    for chunk in chunks(*given, **named):
        last = (last + chunk)[-LONGEST_END:]
        yield chunk
    if end not in last:
        raise InputError("an answer by DICOMweb was cut short; fetch it again")
