"""What an archive may bring with a scan, by C-GET or C-MOVE, and where it brings what C-MOVE asks it for.

All that a study holds is fetched, so that it comes whole: dose reports, pictures of the screen, the node's answers. A
receiver of C-MOVE, a storage provider that is there for one peer and one request, may take any number of classes. Who
asks by C-GET has 128 presentation contexts for all of them: scans and pictures get one for each transfer syntax, as
they may lie in the archive compressed.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from pynetdicom import AE, ALL_TRANSFER_SYNTAXES, AllStoragePresentationContexts
from pynetdicom.presentation import PresentationContext, build_context

from ronnaplan.ct.header import EXPLICIT_LITTLE, IMPLICIT_LITTLE
from ronnaplan.ct.limits import MIB
from ronnaplan.errors import InputError
from ronnaplan.node.classes import CLASSES, COMPANIONS, OTHER_MODALITIES, PICTURES, PLAIN_SYNTAXES, SYNTAXES
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.receiver import is_at
from ronnaplan.node.tls import context
from ronnaplan.node.transport import LARGEST_PDU, PENDING_PER_ASSOCIATION, Server, set_up_pynetdicom


def asked_for() -> list[PresentationContext]:
    """Return in what an archive may send, by C-GET, what a study holds."""
    without_pixels = [one for one in CLASSES if one not in PICTURES]
    return [
        *(build_context(one, syntax) for one in PICTURES for syntax in SYNTAXES),
        *(build_context(one, syntax) for one in without_pixels for syntax in PLAIN_SYNTAXES),
        *(
            build_context(one, [EXPLICIT_LITTLE, IMPLICIT_LITTLE])
            for one in (*COMPANIONS, *OTHER_MODALITIES)
            if one not in PICTURES
        ),
    ]


@contextmanager
def destination(config: Config, peer: Peer, handlers: Sequence[Any]) -> Iterator[None]:
    """Take instances from ``peer`` meanwhile, each by ``handlers``; raises `InputError` where the port is taken."""
    set_up_pynetdicom()
    entity = AE(config.titles[0])
    entity.maximum_pdu_size, entity.require_called_aet = LARGEST_PDU, True
    limits = config.limits
    entity.network_timeout = entity.acse_timeout = entity.dimse_timeout = limits.silent_s
    entity.supported_contexts = _taken()
    try:
        server = Server(
            entity,
            (config.host, config.port),
            config.titles[0],
            entity.supported_contexts,
            context(config.tls, config.home, server=True) if config.tls else None,
            list(handlers),
            allowed=lambda address: is_at(peer.host, address),
            refuse=lambda address, reason: None,
            most_connections=PENDING_PER_ASSOCIATION * limits.associations,
            silent_s=limits.silent_s,
            most_bytes=limits.largest_instance_mib * MIB,
        )
    except OSError as error:
        raise InputError(
            f"nothing can be brought to {config.host}:{config.port} ({error.strerror}), perhaps as the node runs there;"
            " choose another port that the archive knows, or a peer that offers C-GET"
        ) from error
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, name="destination")
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        server.part()
        thread.join()


def _taken() -> list[PresentationContext]:
    """Return in what an archive may bring, by C-MOVE, what a study holds: scans as they can be read."""
    standard = (str(one.abstract_syntax) for one in AllStoragePresentationContexts)
    return [
        *(build_context(one, list(SYNTAXES)) for one in CLASSES),
        *(
            build_context(one, ALL_TRANSFER_SYNTAXES)
            for one in sorted({*standard, *COMPANIONS, *OTHER_MODALITIES} - {*CLASSES})
        ),
    ]
