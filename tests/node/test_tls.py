"""Encrypted associations: with the right certificates, and with no others."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.ct import makers
from tests.node.peers import listening, needs, save, send

pytestmark = [
    needs("storescu"),
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed to make certificates"),
]


def certificate(folder: Path, name: str) -> None:
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1"]
    files = ["-keyout", str(folder / f"{name}.key"), "-out", str(folder / f"{name}.pem")]
    subprocess.run([*command, *files], check=True, capture_output=True)


def test_only_peers_with_a_known_certificate_are_served(tmp_path: Path) -> None:
    for name in ("node", "scanner", "stranger"):
        certificate(tmp_path, name)
    path = save(makers.dataset(0), tmp_path / "0.dcm")
    tls = {"certificate": "node.pem", "key": "node.key", "authorities": "scanner.pem"}
    with listening(tmp_path, tls=tls) as node:

        def options(name: str) -> list[str]:
            own = ["+tls", str(tmp_path / f"{name}.key"), str(tmp_path / f"{name}.pem")]
            return [*own, "+cf", str(tmp_path / "node.pem")]

        assert "(Success)" not in send(node.port, path, options=options("stranger"))
        assert "(Success)" not in send(node.port, path)
        assert node.files() == []
        assert "(Success)" in send(node.port, path, options=options("scanner"))
        assert len(node.files()) == 1
        assert "TLS could not be agreed on" in node.events("refused association")[0]["reason"]
