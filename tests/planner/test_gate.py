"""Who has no token, or comes by another name, gets nothing; and nothing but the page's own files is served."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests import cases
from tests.planner.browser import Planner, environment


def test_without_the_token_or_by_another_name_nothing_is_served(shared: Planner) -> None:
    address = urlsplit(shared.url)
    base = f"http://{address.netloc}"
    token = address.query.partition("=")[2]
    refused = [
        (f"{base}/index.html", {}),
        (f"{base}/index.html?token=wrong", {}),
        (f"{base}/ws", {"Connection": "Upgrade", "Upgrade": "websocket"}),
        (f"{base}/index.html", {"Cookie": f"ronnaplan_{address.port}=\xff"}),
        (f"{base}/index.html?token=%ff", {}),
        *((shared.url, {"Host": host}) for host in ("evil.example", "127.0.0.1:99999999", "a@127.0.0.1", "[", "")),
        *((shared.url, {"Origin": origin}) for origin in ("http://evil.example", "http://[", "null", "\xff")),
    ]
    for url, headers in refused:
        with pytest.raises(urllib.error.HTTPError) as error:
            urllib.request.urlopen(urllib.request.Request(url, headers=headers))
        assert error.value.code == 403, url
        error.value.close()
    for path in ("/planner_page/../../server.py", "/planner_page/%2e%2e/server.py", "//etc/passwd"):
        with pytest.raises(urllib.error.HTTPError) as error:
            urllib.request.urlopen(f"{base}{path}?token={token}")
        assert error.value.code in (403, 404), path
        error.value.close()
    with urllib.request.urlopen(shared.url) as answer:
        assert answer.status == 200
        assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
        ahead = re.findall("<(.*?)>", answer.headers["Link"])
    assert "page.js" in ahead
    for path in ahead:  # what the browser is told to fetch is there
        urllib.request.urlopen(f"{base}/{path}?token={token}").close()


def test_the_planner_listens_on_this_machine_only(shared: Planner) -> None:
    address = urlsplit(shared.url)
    assert address.hostname == "127.0.0.1"
    try:
        others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    except socket.gaierror:
        pytest.skip("this machine does not know its own name, so its other addresses are not known either")
    for other in map(str, others - {"127.0.0.1"}):
        with pytest.raises(OSError):  # noqa: PT011  (refused, unreachable or timed out: any will do)
            socket.create_connection((other, address.port), timeout=2).close()


def test_a_port_in_use_is_told_in_a_sentence(shared: Planner, tmp_path: Path) -> None:
    port = str(urlsplit(shared.url).port)
    command = [sys.executable, "-m", "ronnaplan", "view", str(cases.CT), "--plan", str(tmp_path / "p.json")]
    ended = subprocess.run(
        [*command, "--port", port], capture_output=True, text=True, env=environment(), timeout=60
    )
    assert ended.returncode == 1
    sentence = f"ronnaplan: cannot listen on 127.0.0.1:{port}"
    assert [line.startswith(sentence) for line in ended.stderr.splitlines()].count(True) == 1, ended.stderr
    assert "Traceback" not in ended.stderr
