"""A client of DICOMweb that is patient with a busy archive, and what its errors mean."""

from __future__ import annotations

import ssl
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

from ronnaplan.errors import InputError
from ronnaplan.node.web_answers import Heard

if TYPE_CHECKING:
    from pydicom.dataset import Dataset
    from urllib3.util import Retry

    from ronnaplan.node.config import Limits, Peer

AGAIN: Final = 4
"""So often an archive that is busy is asked again: at once, and after 2, 4 and 8 s more."""
BUSY: Final = (408, 429, 503, 504)
CONFLICT: Final = 409
"""Status of an archive that stored none of what it was sent."""
AS_STORED: Final = (("application/dicom", "*"),)
"""Instances in whichever transfer syntax an archive has them: it changes them by default, or fails where it cannot."""
UNACCEPTABLE: Final = (400, 406)
"""Status of an archive that does not know that it may be asked for them so."""


def web_client(peer: Peer, limits: Limits) -> tuple[Any, Heard]:
    """Return a client of a peer's DICOMweb that waits within ``limits``, and what the peer says beside."""
    from dicomweb_client.api import DICOMwebClient
    from requests import Session
    from requests.adapters import HTTPAdapter

    heard, session = Heard(peer.name, limits.largest_instance_mib), Session()
    for scheme in ("http://", "https://"):
        session.mount(scheme, HTTPAdapter(max_retries=_patience()))
    client = DICOMwebClient(str(peer.url), session=session, callback=heard.hear, timeout=limits.silent_s)
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
    causes = list(_causes(error))
    distrust = next((one for one in causes if isinstance(one, ssl.SSLCertVerificationError)), None)
    if distrust is not None:
        return InputError(
            f"{peer.name} shows a certificate that is not trusted ({distrust.verify_message}); check its address, and "
            "name the PEM file of the authority that signed it in the environment variable REQUESTS_CA_BUNDLE"
        )
    told = "it does not answer" if isinstance(error, Timeout) else _innermost(causes)
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


def _innermost(causes: Sequence[BaseException]) -> str:
    """Return what the system said, without what the libraries on the way have made of it."""
    said = str(causes[0])
    for one in causes[1:]:
        if isinstance(one, OSError) and one.strerror:
            said = f"{one.strerror[:1].lower()}{one.strerror[1:]}"
    return said


def _causes(error: BaseException) -> Iterator[BaseException]:
    """Yield an error, what it was raised for, and so on; urllib3 tells some as an argument only."""
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        told = next((one for one in cause.args if isinstance(one, BaseException)), None)
        cause = cause.__cause__ or cause.__context__ or told


def _patience() -> Retry:
    """Return how often an archive that is busy is asked again; what cannot be connected is told at once."""
    from urllib3.util import Retry

    return Retry(
        AGAIN,
        connect=0,
        read=0,
        other=0,
        status_forcelist=BUSY,
        allowed_methods=("GET",),
        backoff_factor=1.0,
        respect_retry_after_header=False,
        raise_on_status=False,
    )
