"""A peer that a verb talks to: one of a configuration, or an address."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ronnaplan.extras import require_packages

if TYPE_CHECKING:
    from ronnaplan.node.config import Config, Peer

PEER = "a peer's name in the configuration, TITLE@HOST:PORT, or an address of DICOMweb"


def with_config(parser: argparse.ArgumentParser) -> None:
    """Declare the argument that says who peers are."""
    parser.add_argument("--config", metavar="FILE", help="node.toml: peers, this side's AE title, certificates")


def peer_of(arguments: argparse.Namespace) -> tuple[Config, Peer]:
    """Return the configuration and the peer that were named; raises `InputError` where they cannot be talked to."""
    require_packages("fetching", "node", "pynetdicom", "dicomweb_client")
    from ronnaplan.node.config import Config, read_config
    from ronnaplan.node.pull import peer_at

    config = read_config(arguments.config) if arguments.config else Config()
    return config, peer_at(arguments.peer, config)
