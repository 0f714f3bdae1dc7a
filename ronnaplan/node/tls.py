"""Encrypted associations as BCP 195 (RFC 8996, 9325) has them, with certificates of both sides (PS3.15, annex B)."""

from __future__ import annotations

import ssl
from pathlib import Path

from ronnaplan.errors import InputError
from ronnaplan.node.config import Tls
from ronnaplan.text import printable

CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"
"""Of TLS 1.2, with forward secrecy and authenticated; those of 1.3 are all so."""


class _Connection(ssl.SSLSocket):
    """Has its context remember why TLS was not agreed on: pynetdicom tells nobody."""

    def do_handshake(self, block: bool = False) -> None:
        """See `ssl.SSLSocket`."""
        try:
            super().do_handshake(block)
        except OSError as error:
            if isinstance(self.context, Context):
                self.context.fault = getattr(error, "verify_message", "") or str(error)
            raise


class Context(ssl.SSLContext):
    """One side's certificates, and the ``fault`` for which TLS was not agreed on with them the last time."""

    sslsocket_class = _Connection
    fault = ""


def context(tls: Tls, home: Path, *, server: bool) -> Context:
    """Return the context of one side; raises `InputError` for certificates that cannot be used."""
    made = Context(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    made.minimum_version = ssl.TLSVersion.TLSv1_2
    made.set_ciphers(CIPHERS)
    made.verify_mode = ssl.CERT_REQUIRED
    try:
        for name in ("certificate", "key", "authorities"):
            path = home / getattr(tls, name)
            if not path.is_file():
                raise InputError(
                    f"{name} of [tls] is {printable(path)}, and no such file is there; correct the path"
                )
        made.load_cert_chain(home / tls.certificate, home / tls.key, password=_no_pass_phrase)
        made.load_verify_locations(home / tls.authorities)
    except (OSError, ssl.SSLError) as error:
        raise InputError(
            f"the certificates of [tls] cannot be used ({error}); expected PEM files of certificate, key, authorities"
        ) from error
    return made


def _no_pass_phrase() -> str:
    """Refuse a key that is locked, for which a person would be asked."""
    raise InputError(
        "the key of [tls] is locked by a pass phrase, which nobody is there to enter; expected a key without one, that "
        "only the node's user can read"
    )
