"""Ways to a receiver of answers: C-STORE with storage commitment on one association, or STOW-RS."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from pydicom import dcmread
from pydicom.dataset import Dataset
from pydicom.uid import (
    Comprehensive3DSRStorage,
    EncapsulatedPDFStorage,
    SecondaryCaptureImageStorage,
    SpatialFiducialsStorage,
    SpatialRegistrationStorage,
)

from ronnaplan.ct.header import EXPLICIT_LITTLE
from ronnaplan.errors import InputError
from ronnaplan.node.commitment import ASK, COMMITMENT, WELL_KNOWN
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.store import Status
from ronnaplan.node.web import refusals, unreached, web_client

if TYPE_CHECKING:
    from pynetdicom import evt
    from pynetdicom.association import Association

CLASSES: Final = (
    *(SpatialFiducialsStorage, SpatialRegistrationStorage),
    *(Comprehensive3DSRStorage, EncapsulatedPDFStorage, SecondaryCaptureImageStorage),
)
"""What is sent."""
STORED: Final = 200
"""Status of HTTP that says that every instance was stored (PS3.18, 10.5.3)."""
REPORT_S: Final = 1.0
"""So long a receiver may take to say on the same association what it keeps; later it opens one of its own."""
LOOK_S: Final = 0.02

Note = Callable[["evt.Event"], Any]
"""What notes a receiver's report, and answers it."""


class Channel(Protocol):
    """An open way to a receiver; ``commits`` says whether it offers storage commitment."""

    commits: bool

    def ask(self, request: Dataset) -> None:
        """Ask for storage commitment; raises `InputError` where the request is not taken, others where nobody knows."""

    def send(self, path: Path) -> None:
        """Hand over a file; raises `InputError` where it is not taken."""


@contextmanager
def open_channel(config: Config, peer: Peer, note: Note) -> Iterator[Channel]:
    """Open a way to ``peer``, whose report on commitment goes to ``note``; raises `InputError` if it is not reached."""
    if peer.url is not None:
        yield _Web(config, peer)
        return
    from pynetdicom import evt

    from ronnaplan.node.association import associated

    reported = threading.Event()

    def heard(event: evt.Event) -> Any:
        try:
            return note(event)
        finally:
            reported.set()

    handlers = [(evt.EVT_N_EVENT_REPORT, heard)]
    with associated(config, peer, [*CLASSES, COMMITMENT], handlers=handlers) as association:
        yield _Storage(association, peer, reported)


class _Storage:
    def __init__(self, association: Association, peer: Peer, reported: threading.Event) -> None:
        self._association, self._peer, self._reported = association, peer, reported
        self.commits = any(one.abstract_syntax == COMMITMENT for one in association.accepted_contexts)
        # pynetdicom sends a file as it lies there, piece by piece, and what must be encoded anew, from a copy of it all
        self._as_it_is = all(one.transfer_syntax[0] == EXPLICIT_LITTLE for one in association.accepted_contexts)

    def ask(self, request: Dataset) -> None:
        status, _ = self._association.send_n_action(request, ASK, COMMITMENT, WELL_KNOWN)
        if "Status" not in status:
            raise ConnectionError(
                f"{self._peer.name} went before it took a request for storage commitment; it may have to be told of "
                "this node (Orthanc: DicomModalities)"
            )
        if status.Status != 0:
            raise InputError(f"{self._peer.name} takes no request for storage commitment")
        until = time.monotonic() + REPORT_S
        while self._association.is_established and time.monotonic() < until and not self._reported.wait(LOOK_S):
            pass

    def send(self, path: Path) -> None:
        from pynetdicom.status import STATUS_SUCCESS, STATUS_WARNING, code_to_category

        try:
            answer = self._association.send_c_store(path if self._as_it_is else dcmread(path))
        except (ValueError, RuntimeError, OSError) as error:  # no context for its class, no connection any more
            raise InputError(f"{self._peer.name} takes it not: {error}") from error
        status = answer.get("Status")
        is_there = status == Status.DUPLICATE  # its UID is made of what it says
        if status is None or not (is_there or code_to_category(status) in (STATUS_SUCCESS, STATUS_WARNING)):
            said = "nothing" if status is None else f"{status:04X}"
            raise InputError(f"{self._peer.name} answered {said}; expected 0000")


class _Web:
    def __init__(self, config: Config, peer: Peer) -> None:
        self._peer, self.commits = peer, False
        self._client, self._heard = web_client(peer, config.limits)

    def ask(self, request: Dataset) -> None:
        raise InputError(f"{self._peer.name} is spoken to by DICOMweb, which has no storage commitment")

    def send(self, path: Path) -> None:
        import requests

        sent = dcmread(path)
        try:
            answer = self._client.store_instances([sent])
        except (requests.RequestException, OSError) as error:
            refused = refusals(error)  # of an instance that came alone
            if refused is None:
                raise unreached(self._peer, error) from error
            answer = refused
        for failed in answer.get("FailedSOPSequence") or []:
            reason = failed.get("FailureReason", 0)
            if reason == Status.DUPLICATE:  # its UID is made of what it says
                return
            raise InputError(f"{self._peer.name} answered {reason:04X}; expected no failure")
        stored = {one.get("ReferencedSOPInstanceUID") for one in answer.get("ReferencedSOPSequence") or []}
        if sent.SOPInstanceUID not in stored and (stored or self._heard.status != STORED):
            raise InputError(
                f"{self._peer.name} answered {self._heard.status} and does not say that it has stored the instance"
            )
