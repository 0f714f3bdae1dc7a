"""Encrypted associations: with the right certificates, and with no others."""

from __future__ import annotations

import shutil
import socket
import ssl
import subprocess
from pathlib import Path

import pytest

from ronnaplan.errors import InputError
from ronnaplan.node.config import Tls
from ronnaplan.node.tls import context
from tests.ct import makers
from tests.node.peers import listening, needs, save, send

pytestmark = [
    needs("storescu"),
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed to make certificates"),
]


def certificate(folder: Path, name: str, address: str = "127.0.0.1") -> None:
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}"]
    command += ["-addext", f"subjectAltName=IP:{address}"]
    files = ["-keyout", str(folder / f"{name}.key"), "-out", str(folder / f"{name}.pem")]
    subprocess.run([*command, *files], check=True, capture_output=True)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with those of the node, a scanner and a stranger."""
    folder = tmp_path_factory.mktemp("certificates")
    for name in ("node", "scanner", "stranger"):
        certificate(folder, name)
    return folder


def test_only_peers_with_a_known_certificate_are_served(certificates: Path, tmp_path: Path) -> None:
    path = save(makers.dataset(0), tmp_path / "0.dcm")
    files = {"certificate": "node.pem", "key": "node.key", "authorities": "scanner.pem"}
    with listening(tmp_path, tls={kind: str(certificates / name) for kind, name in files.items()}) as node:

        def options(name: str) -> list[str]:
            own = ["+tls", str(certificates / f"{name}.key"), str(certificates / f"{name}.pem")]
            return [*own, "+cf", str(certificates / "node.pem")]

        assert "(Success)" not in send(node.port, path, options=options("stranger"))
        assert "(Success)" not in send(node.port, path)
        assert node.files() == []
        assert "(Success)" in send(node.port, path, options=options("scanner"))
        assert len(node.files()) == 1
        assert "TLS could not be agreed on" in node.events("refused association")[0]["reason"]


@pytest.mark.parametrize(
    ("version", "ciphers", "is_agreed_on"),
    [
        (ssl.TLSVersion.TLSv1_3, "DEFAULT", True),
        (ssl.TLSVersion.TLSv1_2, "ECDHE-RSA-AES256-GCM-SHA384", True),
        (ssl.TLSVersion.TLSv1_2, "DHE-RSA-AES128-GCM-SHA256", False),
        (ssl.TLSVersion.TLSv1_2, "AES256-GCM-SHA384", False),  # no forward secrecy
        (ssl.TLSVersion.TLSv1_2, "ECDHE-RSA-AES256-SHA384", False),  # no AEAD
        (ssl.TLSVersion.TLSv1_1, "ALL:@SECLEVEL=0", False),
    ],
)
@pytest.mark.filterwarnings("ignore:ssl.TLSVersion:DeprecationWarning")
def test_only_what_bcp_195_allows_is_agreed_on(
    version: ssl.TLSVersion, ciphers: str, is_agreed_on: bool, certificates: Path, tmp_path: Path
) -> None:
    files = {"certificate": "node.pem", "key": "node.key", "authorities": "scanner.pem"}
    own = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    own.load_verify_locations(certificates / "node.pem")
    own.load_cert_chain(certificates / "scanner.pem", certificates / "scanner.key")
    own.minimum_version = own.maximum_version = version
    own.set_ciphers(ciphers)
    with listening(tmp_path, tls={kind: str(certificates / name) for kind, name in files.items()}) as node:
        try:
            with (
                socket.create_connection(("127.0.0.1", node.port), 10) as connection,
                own.wrap_socket(connection, server_hostname="127.0.0.1") as encrypted,
            ):
                agreed_on = encrypted.version() is not None
        except ssl.SSLError:
            agreed_on = False
    assert agreed_on is is_agreed_on


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (
            {"certificate": "none.pem"},
            r"certificate of \[tls\] is .*none\.pem, and no such file is there; correct",
        ),
        ({"authorities": "."}, r"authorities of \[tls\] is .*, and no such file is there"),
        ({"key": "a" * 300}, "the certificates of .* cannot be used .*name too long"),
        ({"key": "locked.key"}, r"the key of \[tls\] is locked by a pass phrase"),
        ({"key": "stranger.key"}, "cannot be used .*mismatch"),
    ],
)
def test_certificates_that_cannot_be_used_are_told_by_name(
    given: dict[str, str], says: str, certificates: Path
) -> None:
    locked = ["openssl", "rsa", "-aes256", "-passout", "pass:1234", "-in", str(certificates / "node.key")]
    subprocess.run([*locked, "-out", str(certificates / "locked.key")], check=True, capture_output=True)
    files = {"certificate": "node.pem", "key": "node.key", "authorities": "scanner.pem"} | given
    with pytest.raises(InputError, match=says):
        context(Tls(**files), certificates, server=True)
