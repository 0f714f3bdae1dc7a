"""What peers talk to: verification and storage. Runs in a process of its own (`ronnaplan.node.listening`).

An instance is acknowledged when it is safe (`ronnaplan.node.store`), or refused with a status that makes its sender
keep it.
"""

from __future__ import annotations

import socket
from collections import Counter, defaultdict
from contextlib import suppress
from typing import Any, Final

from pynetdicom import AE, evt
from pynetdicom.association import Association

from ronnaplan.ct.limits import MIB
from ronnaplan.errors import InputError
from ronnaplan.node.audit import Audit, Instances
from ronnaplan.node.classes import CLASSES, COMPANIONS, RARER_COMPANIONS, SYNTAXES
from ronnaplan.node.commitment import COMMITMENT
from ronnaplan.node.config import ANY_ADDRESS, Config, Peer
from ronnaplan.node.facts import Facts, read_facts
from ronnaplan.node.logs import LISTENING, Log
from ronnaplan.node.services import Services
from ronnaplan.node.spool import Spool
from ronnaplan.node.steps import PROCEDURE_STEP
from ronnaplan.node.store import Arrival, Status, Store
from ronnaplan.node.storing import Request
from ronnaplan.node.tls import context
from ronnaplan.node.transport import (
    LARGEST_PDU,
    PENDING_PER_ASSOCIATION,
    Server,
    give_up_waiting,
    set_up_pynetdicom,
    titles,
)

VERIFICATION: Final = "1.2.840.10008.1.1"
FOR_RECEIVERS: Final = (VERIFICATION, COMMITMENT)
"""What peers that send no scans may do."""

PERMANENT, BY_USER, UNKNOWN_CALLER, UNKNOWN_CALLED = 1, 1, 3, 7
"""Codes of A-ASSOCIATE-RJ (PS3.8, 9.3.4)."""


class RefusedInstanceError(InputError):
    """An instance that is not taken, and what its sender is told."""

    def __init__(self, status: Status, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class Receiver:
    """The node's storage provider, from `start` to `stop`."""

    def __init__(self, config: Config, log: Log) -> None:
        self.config, self._log = config, log
        config.data.mkdir(parents=True, exist_ok=True)
        self._audit = Audit(config.data, config.audit, config.titles[0], log)
        self._store = Store(
            config.data, log, self._audit, keep_days=config.keep_days, least_free_mib=config.limits.least_free_mib
        )
        self._moved: dict[Any, dict[str, Instances]] = defaultdict(dict)
        self._known: dict[Any, Counter[str]] = defaultdict(Counter)
        self._server: Server | None = None

    @property
    def port(self) -> int:
        """Where it listens, once started."""
        if self._server is None:
            raise InputError("the node does not listen; start it first")
        return int(self._server.server_address[1])

    def start(self) -> None:
        """Listen; raises `InputError` where the port is taken or a certificate cannot be used."""
        config = self.config
        set_up_pynetdicom()
        encrypted = context(config.tls, config.home, server=True) if config.tls else None
        self._store.start()
        try:
            entity = self._entity()
            self._server = Server(
                entity,
                (config.host, config.port),
                config.titles[0],
                entity.supported_contexts,
                encrypted,
                [
                    (evt.EVT_REQUESTED, self._admit),
                    (evt.EVT_CONN_CLOSE, self._gone),
                    (evt.EVT_ABORTED, self._aborted),
                    *Services(config, self._log, self._peer_of).handlers,
                ],
                allowed=self._is_allowed,
                refuse=lambda address, reason: log_refusal(self._log, address, reason),
                most_connections=PENDING_PER_ASSOCIATION * config.limits.associations,
                silent_s=config.limits.silent_s,
                most_bytes=config.limits.largest_instance_mib * MIB,
                storage=self,
            )
        except OSError as error:
            raise InputError(
                f"cannot listen on {config.host}:{config.port} ({error.strerror}); correct 'host' or 'port' in the "
                "configuration"
            ) from error
        self._log.tell(LISTENING, host=config.host, port=self.port, tls=encrypted is not None)

    def serve(self) -> None:
        """Serve peers until `stop`."""
        if self._server is not None:
            self._server.serve_forever(poll_interval=0.1)

    def stop(self) -> None:
        """Let go of the port, finish what waits, and part from peers."""
        if self._server is not None:
            self._server.shutdown()
        self._store.stop()
        if self._server is not None:
            self._server.part()

    def _entity(self) -> AE:
        entity = AE(self.config.titles[0])
        limits = self.config.limits
        entity.maximum_pdu_size = LARGEST_PDU
        entity.maximum_associations = limits.associations
        entity.network_timeout = entity.dimse_timeout = limits.silent_s
        entity.acse_timeout = limits.silent_s + 1.0  # after the connection's own end, which is told
        entity.add_supported_context(VERIFICATION)
        entity.add_supported_context(PROCEDURE_STEP)
        # a receiver that reports is its provider
        entity.add_supported_context(COMMITMENT, scu_role=True, scp_role=True)
        for sop_class in (*CLASSES, *COMPANIONS, *RARER_COMPANIONS):
            entity.add_supported_context(sop_class, list(SYNTAXES))
        return entity

    def _is_allowed(self, address: str) -> bool:
        return any(is_at(one.host, address) for one in self.config.peer if one.speaks)

    def _peer_of(self, event: evt.Event) -> Peer | None:
        """Return who speaks on an association; None for a stranger."""
        calling, _ = titles(event.assoc)
        address = str(event.assoc.requestor.address)
        known = [one for one in self.config.peer if one.speaks and one.title == calling]
        return next((one for one in known if is_at(one.host, address)), None)

    def _admit(self, event: evt.Event) -> None:
        """Refuse who calls by another name, or is no known peer at this address; take scans from senders only."""
        calling, called = titles(event.assoc)
        peer = self._peer_of(event)
        diagnostic, reason = 0, ""
        if called not in self.config.titles:
            diagnostic, reason = UNKNOWN_CALLED, f"no AE title here is {called}"
        elif peer is None:
            diagnostic, reason = UNKNOWN_CALLER, f"{calling} is no peer that may send from there"
        elif not peer.sends:
            own = event.assoc.acceptor
            own.supported_contexts = [
                one for one in own.supported_contexts if one.abstract_syntax in FOR_RECEIVERS
            ]
        if reason:
            log_refusal(self._log, str(event.assoc.requestor.address), reason)
            event.assoc.acse.send_reject(PERMANENT, BY_USER, diagnostic)
            event.assoc.kill()

    def begin(self, request: Request) -> Spool:
        """Return the file to write an instance to."""
        return Spool(self._store.incoming, request.sop_class, request.sop_uid, request.syntax)

    def end(self, association: Association, request: Request, spool: Spool) -> int:
        """Have an instance kept; return the status that its sender is told."""
        calling, called = titles(association)
        try:
            facts = self._facts(request, spool)
        except RefusedInstanceError as error:
            spool.remove()
            status = error.status
            self._log.tell(
                "refused", status=f"{status:04X}", reason=str(error), sop_instance=request.sop_uid, calling=calling
            )
            return int(status)
        spool.keep()
        arrival = Arrival(facts, spool.path, calling, called)
        taken = self._store.take(arrival)
        if taken.status is Status.SUCCESS:
            self._note(association, arrival)
            self._known[association][facts.study_uid] += taken.was_known
        return int(taken.status)

    def cut_off(self, association: Association) -> None:
        """Tell of a peer that sent half an instance."""
        self._tell_cut_off(association, "an instance was begun and never sent whole")

    def _facts(self, request: Request, spool: Spool) -> Facts:
        """Return who an instance is, once its content is on the disk; raises `RefusedInstanceError`."""
        try:
            if not self._store.has_room():
                self._note_lacking(spool)
                least = self.config.limits.least_free_mib
                raise RefusedInstanceError(Status.NO_ROOM, f"less than {least} MiB are free on the disk")
            spool.sync()
        except OSError as error:  # the node's folder itself may be gone, as with its disk
            self._note_lacking(spool)
            raise RefusedInstanceError(Status.NO_ROOM, f"it cannot be written: {error.strerror}") from error
        try:
            # half of one, once kept, would keep the whole one of its UID out
            facts = read_facts(spool.path, spool.sha256, only_whole=True)
        except (InputError, OSError) as error:
            raise RefusedInstanceError(Status.NOT_UNDERSTOOD, str(error)) from error
        if (facts.sop_uid, facts.sop_class) != (request.sop_uid, request.sop_class):
            raise RefusedInstanceError(Status.NO_MATCH, f"it holds instance {facts.sop_uid} of {facts.sop_class}")
        return facts

    def _note_lacking(self, spool: Spool) -> None:
        """Have a series wait for an instance that there is no room for, as far as its beginning could be written."""
        with suppress(InputError, OSError):
            self._store.note_lacking(read_facts(spool.path, spool.sha256))

    def _note(self, association: Association, arrival: Arrival) -> None:
        facts = arrival.facts
        moved = self._moved[association].setdefault(facts.study_uid, Instances(facts.study_uid))
        if not moved.hashes and self.config.names_in_logs:
            self._log.tell("study", study=facts.study_uid, patient=facts.patient_name)
        moved.add(facts.sop_class, facts.sha256)

    def _gone(self, event: evt.Event) -> None:
        """Tell what was received on an association, or why it was none."""
        association = event.assoc
        if association.requestor.primitive is None:
            self._tell_cut_off(association, "no association was asked for")
            give_up_waiting(association)
        calling, called = titles(association)
        address = str(association.requestor.address)
        known = self._known.pop(association, Counter())
        for moved in self._moved.pop(association, {}).values():
            self._log.tell(
                "received", study=moved.study_uid, instances=len(moved.hashes), calling=calling, called=called
            )
            if known[moved.study_uid]:
                self._log.tell(
                    "known already", study=moved.study_uid, instances=known[moved.study_uid], calling=calling
                )
            self._audit.transferred(moved, source=calling, destination=self.config.titles[0], peer_address=address)

    def _aborted(self, event: evt.Event) -> None:
        """Tell of a peer that was silent for too long."""
        if event.assoc.dul.idle_timer_expired():
            self._tell_cut_off(event.assoc, f"nothing came for {self.config.limits.silent_s:g} s")

    def _tell_cut_off(self, association: Association, reason: str) -> None:
        address = str(association.requestor.address)
        self._log.tell("cut off", calling=titles(association)[0], address=address, reason=reason)


def is_at(host: str, address: str) -> bool:
    """Whether ``host``, a name or an address, has ``address``."""
    if host in (ANY_ADDRESS, address):
        return True
    with suppress(OSError):
        return any(found[4][0] == address for found in socket.getaddrinfo(host, None))
    return False


def log_refusal(log: Log, address: str, reason: str) -> None:
    """Tell of a connection or an association that was turned away."""
    log.tell("refused association", address=address, reason=reason)
