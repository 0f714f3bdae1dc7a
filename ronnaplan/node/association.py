"""Associations that this side asks for, with the same bounds of time as those that others ask for."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from pynetdicom import AE, evt
from pynetdicom.association import Association
from pynetdicom.presentation import PresentationContext, build_role

from ronnaplan.ct.header import EXPLICIT_LITTLE, IMPLICIT_LITTLE
from ronnaplan.errors import InputError
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.tls import Context, context
from ronnaplan.node.transport import LARGEST_PDU, end_at_fault, give_up_waiting, set_up_pynetdicom

LOOK_S = 0.001
"""So often it is looked whether a thread has come to where it waits."""
SYNTAXES = (EXPLICIT_LITTLE, IMPLICIT_LITTLE)


@contextmanager
def associated(
    config: Config,
    peer: Peer,
    classes: Sequence[str],
    *,
    provided: Sequence[str] = (),
    stored: Sequence[PresentationContext] = (),
    handlers: Sequence[Any] = (),
) -> Iterator[Association]:
    """Yield an association with ``peer`` for ``classes``; instances may be sent back on it as ``stored`` (C-GET).

    Of the classes in ``provided`` this side is the provider.

    Raises `InputError` where it comes to none.
    """
    entity = _asking(config, (*classes, *provided))
    back = {str(one.abstract_syntax) for one in stored}
    own = context(config.tls, config.home, server=False) if peer.tls and config.tls else None
    named = f"{peer.name} ({peer.title} at {peer.host}:{peer.port})"
    try:
        association = entity.associate(
            peer.host,
            peer.port,
            ae_title=peer.title,
            max_pdu=LARGEST_PDU,
            contexts=[*entity.requested_contexts, *stored],
            ext_neg=[build_role(sop_class, scp_role=True) for sop_class in (*provided, *back)],
            tls_args=None if own is None else (own, peer.host),
            evt_handlers=[(evt.EVT_CONN_OPEN, _bound, [config.limits.silent_s]), *handlers],
        )
    except (OSError, UnicodeError) as error:
        raise InputError(f"{named} cannot be reached: no host of this name is known; check its address") from error
    try:
        if not association.is_established:
            raise InputError(f"{named} {_why_not(association, own)}")
        Checkpoint(association).guard()
        yield association
    except KeyboardInterrupt:  # the peer may be amid a long answer
        association.abort()
        raise
    finally:
        if association.is_established:
            association.release()
        else:
            association.abort()


def _bound(event: evt.Event, silent_s: float) -> None:
    """Have the thread that speaks with a peer wait no longer for it amid a message, where pynetdicom waits for ever."""
    connection = event.assoc.dul.socket
    if connection is not None and connection.socket is not None:
        connection.socket.settimeout(silent_s)
    end_at_fault(event.assoc)


def _why_not(association: Association, own: Context | None) -> str:
    """Return why it came to no association."""
    if association.is_rejected:
        return "refused the association"
    if own is not None and own.fault:
        return f"does not agree on TLS: {own.fault}"
    return "cannot be reached, or speaks no DICOM; check its address"


def _asking(config: Config, classes: Sequence[str]) -> AE:
    """Return this side, which asks for ``classes``."""
    set_up_pynetdicom()
    entity = AE(config.titles[0])
    entity.maximum_pdu_size = LARGEST_PDU
    silent_s = config.limits.silent_s
    entity.connection_timeout = entity.acse_timeout = entity.dimse_timeout = entity.network_timeout = silent_s
    for sop_class in classes:
        entity.add_requested_context(sop_class, list(SYNTAXES))
    return entity


class Checkpoint(threading.Event):
    """Where an association's own thread waits while an answer is awaited in another.

    pynetdicom 3.0 lets that thread say that it waits a moment before and after it does (its issue 875): it then takes
    the first answer and drops it, and a list lacks an entry that nobody misses. It also serves what a peer reports
    (N-EVENT-REPORT) in a third thread, which says in the end that nobody waits: who lets go of the association would
    look for that for ever, or let go before the report is answered. Here it waits who is here, whatever others say, and
    who pauses the thread waits for what is served.
    """

    def __init__(self, association: Association) -> None:
        super().__init__()
        self._association = association
        self.serving, self._passing = threading.Lock(), threading.Lock()
        self.is_reached = False
        """Whether the thread has come here and was not let pass yet."""
        self.set()

    def guard(self) -> None:
        """Take the place of the association's checkpoint."""
        self._association._reactor_checkpoint = self
        self._association.__class__ = _Guarded

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the thread may pass; it is no longer paused before another can ask it to be."""
        self.is_reached = True
        while True:
            super().wait(timeout)
            with self._passing:
                if self.is_set():
                    self.is_reached = False
                    return True

    def clear(self) -> None:
        """Let the thread pass no more; return when it is here or has ended, and what the peer reported is answered.

        Who pauses it waits for an answer then, of which there is none where the thread has seen the association end.
        """
        with self.serving, self._passing:
            super().clear()
        while self._association.is_alive() and not self.is_reached:
            time.sleep(LOOK_S)
        if not self._association.is_alive():
            self._association.dimse.msg_queue.put((None, None))
            give_up_waiting(self._association)


class _Guarded(Association):
    """An association of whose thread its `Checkpoint` alone knows whether it waits."""

    _reactor_checkpoint: Checkpoint

    @property
    def _is_paused(self) -> bool:
        """Whether its thread waits, or has ended; pynetdicom looks for that before it sends."""
        return self._reactor_checkpoint.is_reached or not self.is_alive()

    @_is_paused.setter
    def _is_paused(self, said: bool) -> None:
        """Take no notice of what pynetdicom says, which several of its threads do."""

    def _serve_request(self, msg: Any, context_id: int) -> None:
        with self._reactor_checkpoint.serving:
            super()._serve_request(msg, context_id)
