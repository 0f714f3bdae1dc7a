"""The audit trail: who sent what to whom, and what was done with it, as DICOM audit messages (PS3.15, A.5).

One a line of a file, or to syslog.
Patients are named by their studies' UIDs only.
"""

from __future__ import annotations

import base64
import os
import socket
import threading
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import file_digest, sha256
from ipaddress import ip_address
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit
from xml.etree import ElementTree

from ronnaplan.errors import InputError
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log
from ronnaplan.text import printable

SYSLOG: Final = "syslog://"
SYSLOG_PORT: Final = 514
PRIORITY: Final = 85
"""Of syslog: facility 10 (security), severity 5 (notice), as PS3.15, A.6 has it."""

ACCESSED: Final = ("110103", "DICOM Instances Accessed")
TRANSFERRED: Final = ("110104", "DICOM Instances Transferred")
ACTIVITY: Final = ("110100", "Application Activity")
STARTED: Final = ("110120", "Application Start")
STOPPED: Final = ("110121", "Application Stop")
SOURCE: Final = ("110153", "Source Role ID")
DESTINATION: Final = ("110152", "Destination Role ID")
APPLICATION: Final = ("110150", "Application")


CREATED, READ, DELETED, EXECUTED = "C", "R", "D", "E"
"""Kinds of events."""

SUCCESS, MINOR_FAILURE, SERIOUS_FAILURE = "0", "4", "8"
"""How events end: as meant, not yet or with a reason in what was given, for good."""

SERVER_PROCESS: Final = "4"
"""Of audit sources."""

UNWRITTEN: Final = "not audited"
"""The log's event that holds a message that the trail could not take."""


@dataclass
class Instances:
    """What was moved, read or made of one study."""

    study_uid: str
    classes: Counter[str] = field(default_factory=Counter)
    hashes: list[str] = field(default_factory=list)

    def add(self, sop_class: str, content_sha256: str) -> None:
        """Count an instance."""
        self.classes[sop_class] += 1
        self.hashes.append(content_sha256)

    def add_file(self, sop_class: str, path: Path) -> None:
        """Count an instance that lies in a file; one that is gone has the hash of nothing."""
        try:
            with path.open("rb") as file:
                self.add(sop_class, file_digest(file, "sha256").hexdigest())
        except FileNotFoundError:
            self.add(sop_class, sha256().hexdigest())

    @classmethod
    def received(cls, index: Index, study_uid: str, series: int) -> Instances:
        """Return what was received of the series with this number."""
        found = cls(study_uid)
        for row in index.each("SELECT sop_class, sha256 FROM instances WHERE series = ?", series):
            found.add(*row)
        return found

    @property
    def sha256(self) -> str:
        """One hash of all contents: of their hashes in hexadecimal, sorted, one a line."""
        return sha256("\n".join(sorted(self.hashes)).encode()).hexdigest()


class Audit:
    """Writes audit messages to ``target``: a file, or ``syslog://HOST:PORT`` (RFC 5424 over UDP).

    A message that cannot be written there stands in the log, and the node goes on: what it does depends on none.
    """

    def __init__(self, folder: Path, target: str, node: str, log: Log) -> None:
        self._node, self._log, self._lock = node, log, threading.Lock()
        self._target, self._path = target, folder / target
        self._address = syslog_address(target) if target.startswith(SYSLOG) else None

    def started(self) -> None:
        """Tell that the node started; raises `InputError` where the trail cannot be written."""
        try:
            self._put(self._activity(STARTED))
        except OSError as error:
            raise InputError(
                f"the audit trail cannot be written to {printable(self._target)} ({error.strerror or error}); "
                "correct 'audit' in the configuration, or make that place reachable"
            ) from error

    def stopped(self) -> None:
        """Tell that the node stopped."""
        self._write(self._activity(STOPPED))

    def _activity(self, kind: tuple[str, str]) -> ElementTree.Element:
        message = self._message(ACTIVITY, EXECUTED, kind=kind)
        self._participant(message, self._node, APPLICATION, requestor=False)
        self._source(message)
        return message

    def transferred(
        self, moved: Instances, *, source: str, destination: str, peer_address: str, failure: str = ""
    ) -> None:
        """Tell that instances went from ``source`` to ``destination`` (AE titles or addresses), or why they did not."""
        message = self._message(TRANSFERRED, CREATED, MINOR_FAILURE if failure else SUCCESS, failure)
        is_ours = source == self._node
        self._participant(message, source, SOURCE, requestor=True, address="" if is_ours else peer_address)
        self._participant(
            message, destination, DESTINATION, requestor=False, address=peer_address if is_ours else ""
        )
        self._source(message)
        _study(message, moved)
        self._write(message)

    def accessed(
        self, action: str, what: Instances, *, outcome: str = SUCCESS, reason: str = "", **details: str
    ) -> None:
        """Tell that the node read, made or removed instances: `READ`, `CREATED` or `DELETED`, as far as it could."""
        message = self._message(ACCESSED, action, outcome, reason)
        self._participant(message, self._node, APPLICATION, requestor=False)
        self._source(message)
        _study(message, what, **details)
        self._write(message)

    def _message(
        self,
        event: tuple[str, str],
        action: str,
        outcome: str = SUCCESS,
        reason: str = "",
        kind: tuple[str, str] | None = None,
    ) -> ElementTree.Element:
        message = ElementTree.Element("AuditMessage")
        identification = ElementTree.SubElement(
            message,
            "EventIdentification",
            EventActionCode=action,
            EventDateTime=datetime.now(UTC).isoformat(timespec="milliseconds"),
            EventOutcomeIndicator=outcome,
        )
        _coded(identification, "EventID", event)
        if kind is not None:
            _coded(identification, "EventTypeCode", kind)
        if reason:
            ElementTree.SubElement(identification, "EventOutcomeDescription").text = printable(reason)
        return message

    def _participant(
        self,
        message: ElementTree.Element,
        name: str,
        role: tuple[str, str],
        *,
        requestor: bool,
        address: str = "",
    ) -> None:
        where = {"NetworkAccessPointID": address, "NetworkAccessPointTypeCode": _place(address)} if address else {}
        mine = {"AlternativeUserID": str(os.getpid())} if name == self._node else {}
        participant = ElementTree.SubElement(
            message,
            "ActiveParticipant",
            {"UserID": printable(name), "UserIsRequestor": str(requestor).lower(), **mine, **where},
        )
        _coded(participant, "RoleIDCode", role)

    def _source(self, message: ElementTree.Element) -> None:
        name = f"{self._node}@{socket.gethostname()}"
        source = ElementTree.SubElement(message, "AuditSourceIdentification", AuditSourceID=name)
        ElementTree.SubElement(source, "AuditSourceTypeCode", {"csd-code": SERVER_PROCESS})

    def _write(self, message: ElementTree.Element) -> None:
        try:
            self._put(message)
        except OSError as error:
            self._log.tell(UNWRITTEN, reason=str(error), message=_line(message))

    def _put(self, message: ElementTree.Element) -> None:
        line = _line(message)
        with self._lock:
            if self._address is None:
                with self._path.open("a", encoding="utf-8") as stream:
                    stream.write(f"{line}\n")
                return
            now, host = datetime.now(UTC).isoformat(timespec="milliseconds"), socket.gethostname()
            packet = f"<{PRIORITY}>1 {now} {host} ronnaplan {os.getpid()} IHE+RFC-3881 - \ufeff{line}"
            family, kind, *_, address = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)[0]
            with socket.socket(family, kind) as sender:
                sender.sendto(packet.encode(), address)


def syslog_address(target: str) -> tuple[str, int]:
    """Return host and port of ``syslog://HOST:PORT``; raises `InputError` for what is none."""
    try:
        parts = urlsplit(target)
        host, port = parts.hostname, parts.port
    except ValueError:  # of a port that is none, or of brackets that hold no address
        host = port = None
    if not host:
        raise InputError(f"audit is '{printable(target)}'; expected a file or syslog://HOST:PORT")
    return host, SYSLOG_PORT if port is None else port


def _line(message: ElementTree.Element) -> str:
    return ElementTree.tostring(message, encoding="unicode")


def _place(address: str) -> str:
    """Return what ``address`` is by the schema: a machine's name, an IP address or a URI."""
    if "://" in address:
        return "5"
    try:
        ip_address(address)
    except ValueError:
        return "1"
    return "2"


def _study(message: ElementTree.Element, what: Instances, **details: str) -> None:
    """Name the instances' study, with ``details`` in base64, as the schema wants."""
    study = ElementTree.SubElement(
        message,
        "ParticipantObjectIdentification",
        ParticipantObjectID=what.study_uid,
        ParticipantObjectTypeCode="2",
        ParticipantObjectTypeCodeRole="3",
    )
    _coded(study, "ParticipantObjectIDTypeCode", ("110180", "Study Instance UID"))
    ElementTree.SubElement(study, "ParticipantObjectName").text = "study"
    for name, text in {**details, "sha256": what.sha256}.items():
        value = base64.b64encode(text.encode()).decode()
        ElementTree.SubElement(study, "ParticipantObjectDetail", type=name, value=value)
    description = ElementTree.SubElement(study, "ParticipantObjectDescription")
    for uid, count in what.classes.items():
        ElementTree.SubElement(description, "SOPClass", UID=uid, NumberOfInstances=str(count))


def _coded(parent: ElementTree.Element, tag: str, coded: Iterable[str]) -> None:
    code, meaning = coded
    ElementTree.SubElement(parent, tag, {"csd-code": code, "codeSystemName": "DCM", "originalText": meaning})
