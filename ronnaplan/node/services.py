"""What peers ask for and tell beside instances: to be promised storage, what they keep, and that they are done."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from pydicom.dataset import Dataset
from pynetdicom import evt

from ronnaplan.errors import InputError
from ronnaplan.node.commitment import ASK, announce_named, asked_for, note_report, note_request
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log
from ronnaplan.node.steps import SUCCESS, begin_step, change_step
from ronnaplan.node.transport import titles

INVALID_ARGUMENT, NO_SUCH_ACTION, FAILED, NOT_AUTHORISED = 0x0115, 0x0123, 0x0110, 0x0124
"""Statuses of N-ACTION and N-EVENT-REPORT (PS3.7, annex C)."""

Answer = tuple[int, Dataset | None]


class Services:
    """Handlers of what one node is asked for; ``peer_of`` says who speaks on an association."""

    def __init__(self, config: Config, log: Log, peer_of: Callable[[evt.Event], Peer | None]) -> None:
        self._config, self._log, self._peer_of = config, log, peer_of

    @property
    def handlers(self) -> list[Any]:
        """What is done at which of pynetdicom's events."""
        return [
            (evt.EVT_N_ACTION, self.promise),
            (evt.EVT_N_EVENT_REPORT, self.note),
            (evt.EVT_N_CREATE, self.begin_step),
            (evt.EVT_N_SET, self.change_step),
        ]

    def promise(self, event: evt.Event) -> Answer:
        """Take a request for storage commitment; a report follows over an association of its own."""
        peer = self._peer_of(event)
        if peer is None or not peer.port:
            return self._refused(event, NOT_AUTHORISED, "no peer with a port to report to has this title"), None
        if event.action_type != ASK:
            return self._refused(event, NO_SUCH_ACTION, f"action {event.action_type} is none"), None
        try:
            transaction, named = asked_for(event.action_information)
        except InputError as error:
            return self._refused(event, INVALID_ARGUMENT, str(error)), None
        now = time.time()
        with Index(self._config.data) as index, index.transaction():
            note_request(index, peer.name, transaction, named, now)
            if peer.commits_when_done:
                announce_named(index, named, now)
        self._log.tell("commitment asked for", peer=peer.name, transaction=transaction, instances=len(named))
        return SUCCESS, None

    def note(self, event: evt.Event) -> Answer:
        """Note what a receiver of answers keeps."""
        peer = self._peer_of(event)
        if peer is None:
            return self._refused(event, NOT_AUTHORISED, "no peer has this title"), None
        try:
            with Index(self._config.data) as index:
                retry_s = self._config.jobs.retry_s
                kept, failed = note_report(index, peer.name, event.event_information, time.time(), retry_s)
        except InputError as error:
            return self._refused(event, FAILED, str(error)), None
        self._log.tell("commitment", receiver=peer.name, kept=kept, not_kept=failed)
        return SUCCESS, None

    def begin_step(self, event: evt.Event) -> Answer:
        """Note a procedure step that a scanner begins."""
        request: Any = event.request
        uid, told = str(request.AffectedSOPInstanceUID), event.attribute_list
        with Index(self._config.data) as index:
            status = begin_step(index, uid, titles(event.assoc)[0], told, time.time())
        if status != SUCCESS:
            self._refused(event, status, "the step is known already, or is none that is in progress")
            return status, None
        made = Dataset()
        made.SOPClassUID, made.SOPInstanceUID = request.AffectedSOPClassUID, uid
        return SUCCESS, made

    def change_step(self, event: evt.Event) -> Answer:
        """Note what became of a procedure step."""
        request: Any = event.request
        uid, calling = str(request.RequestedSOPInstanceUID), titles(event.assoc)[0]
        with Index(self._config.data) as index:
            status, counts = change_step(index, uid, calling, event.modification_list, time.time())
        if status != SUCCESS:
            return self._refused(event, status, "the step is not known, or over"), None
        for series, count in counts.items():
            self._log.tell("announced", series=series, instances=count, calling=calling)
        return SUCCESS, Dataset()

    def _refused(self, event: evt.Event, status: int, reason: str) -> int:
        self._log.tell("refused", status=f"{status:04X}", reason=reason, calling=titles(event.assoc)[0])
        return status
