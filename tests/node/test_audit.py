"""The audit trail goes to syslog, too."""

from __future__ import annotations

import re
import socket
from pathlib import Path
from xml.etree import ElementTree

import pytest

from ronnaplan.errors import InputError
from ronnaplan.node.audit import Audit, Transfer


def test_a_message_to_syslog_is_one_of_rfc_5424_with_the_hashes(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(10)
        audit = Audit(tmp_path, f"syslog://127.0.0.1:{server.getsockname()[1]}", "RONNAPLAN")
        moved = Transfer("1.2.3")
        moved.add("1.2.840.10008.5.1.4.1.1.2", "ab" * 32)
        audit.transferred(moved, source="CT1", destination="RONNAPLAN", peer_address="192.0.2.7")
        packet = server.recv(65_536).decode()
    head = re.match(r"<\d+>1 \S+ \S+ ronnaplan \d+ IHE\+RFC-3881 - \ufeff", packet)
    assert head is not None
    message = ElementTree.fromstring(packet[head.end() :])
    sender, receiver = message.iter("ActiveParticipant")
    assert (sender.attrib["UserID"], sender.attrib["NetworkAccessPointID"]) == ("CT1", "192.0.2.7")
    assert receiver.attrib["UserID"] == "RONNAPLAN"
    (detail,) = message.iter("ParticipantObjectDetail")
    assert (detail.attrib["type"], len(detail.attrib["value"])) == ("sha256", 64)
    assert not list(tmp_path.iterdir())


def test_an_address_without_a_host_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="syslog://HOST:PORT"):
        Audit(tmp_path, "syslog://", "RONNAPLAN")
