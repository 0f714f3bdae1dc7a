"""Where an archive brings what C-MOVE asks it for: a storage provider that is there for one peer and one request."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from pynetdicom import AE

from ronnaplan.ct.limits import MIB
from ronnaplan.errors import InputError
from ronnaplan.node.companions import taken
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.receiver import is_at
from ronnaplan.node.tls import context
from ronnaplan.node.transport import LARGEST_PDU, PENDING_PER_ASSOCIATION, Server, set_up_pynetdicom


@contextmanager
def destination(config: Config, peer: Peer, handlers: Sequence[Any]) -> Iterator[None]:
    """Take instances from ``peer`` meanwhile, each by ``handlers``; raises `InputError` where the port is taken."""
    set_up_pynetdicom()
    entity = AE(config.titles[0])
    entity.maximum_pdu_size, entity.require_called_aet = LARGEST_PDU, True
    limits = config.limits
    entity.network_timeout = entity.acse_timeout = entity.dimse_timeout = limits.silent_s
    entity.supported_contexts = taken()
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
        thread.join()
