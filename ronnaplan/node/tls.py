"""Encrypted associations as BCP 195 (RFC 8996, 9325) has them, with certificates of both sides (PS3.15, annex B)."""

from __future__ import annotations

import ssl
from pathlib import Path

from ronnaplan.errors import InputError
from ronnaplan.node.config import Tls

CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"
"""Of TLS 1.2, with forward secrecy and authenticated; those of 1.3 are all so."""


def context(tls: Tls, home: Path, *, server: bool) -> ssl.SSLContext:
    """Return the context of one side; raises `InputError` for certificates that cannot be used."""
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    made.minimum_version = ssl.TLSVersion.TLSv1_2
    made.set_ciphers(CIPHERS)
    made.verify_mode = ssl.CERT_REQUIRED
    try:
        made.load_cert_chain(home / tls.certificate, home / tls.key)
        made.load_verify_locations(home / tls.authorities)
    except (OSError, ssl.SSLError) as error:
        raise InputError(
            f"the certificates of [tls] cannot be used ({error}); expected PEM files of certificate, key, authorities"
        ) from error
    return made
