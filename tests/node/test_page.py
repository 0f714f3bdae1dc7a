"""The operator's page: for who has the token, on this machine; it names no patient and nobody can write on it."""

from __future__ import annotations

import http.client
import io
import os
import re
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.node import page as page_module
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log
from ronnaplan.node.page import Page
from tests.node.peers import configuration, until
from tests.node.test_series import facts
from tests.planner.browser import looking, needs_browser


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    config = configuration(tmp_path, page_port=0)
    config.data.mkdir()
    with Index(config.data) as index, index.transaction():
        text = {"description": "<script>x</script>", "patient_name": "Doe^Jane"}
        index.add(facts(1, **text), "x.dcm", "CT1", "RONNAPLAN", 100.0)
        index.run(
            "INSERT INTO jobs (series, revision, rule, state, due, reason, completed)"
            " VALUES (1, 1, 'skin', 'refused', 0, 'no marker & more', 0)"
        )
        index.run("INSERT INTO answers VALUES ('1.9', 1, 'sr', '1.2', 'answers/1/1.9.dcm', 100)")
        index.run("UPDATE series SET expected = 190")
        index.run("INSERT INTO aside VALUES ('aside/x', '1.2', 'CT1', 100)")
    found = Page(config, Log(io.StringIO()))
    found.start()
    yield found
    found.stop()


def ask(page: Page, path: str, method: str = "GET", body: str = "", **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=60)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    content = answer.read().decode()
    connection.close()
    return answer.status, content


def test_the_page_says_what_was_received_what_became_of_it_and_why(page: Page) -> None:
    status, content = ask(page, f"/?token={page.token}")
    assert status == 200
    for text in (
        "CT1",
        "refused",
        "no marker &amp; more",
        "retry",
        "1 of 190",
        ", 1 answer <form",
        "Research software, not a medical device",
        "<main>",  # where a screen reader goes to
        "aside/x",
        "1970-01-01 00:01:40 UTC",
    ):
        assert text in content
    assert "<script" not in content
    assert "Doe" not in content


def test_the_page_stands_still_for_who_reads_it_or_goes_through_it_by_keyboard(page: Page) -> None:
    """To load it again takes focus and selection away."""
    moving, still = (ask(page, f"/?token={page.token}{more}")[1] for more in ("", "&still"))
    assert ['http-equiv="refresh"' in one for one in (moving, still)] == [True, False]
    assert ['href="/?still"' in one for one in (moving, still)] == [True, False]
    assert ">go on by itself</a>" in still
    assert "as of " in still


def test_who_has_no_token_or_comes_by_another_name_gets_nothing(page: Page, tmp_path: Path) -> None:
    assert ask(page, "/")[0] == 403
    assert ask(page, "/?token=x", Cookie="ronnaplan_node=y; =")[0] == 403
    assert ask(page, f"/?token={page.token}", Host="evil.example")[0] == 403
    assert ask(page, "/retry", "POST", "job=1", Origin=f"http://127.0.0.1:{page.port}")[0] == 403
    kept = tmp_path / "node-data" / "page.token"
    assert kept.read_text().strip() == page.token
    if os.name == "posix":
        assert kept.stat().st_mode & 0o077 == 0


def test_who_asks_oddly_or_goes_before_the_answer_leaves_no_traceback(
    page: Page, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ask(page, f"/?token={page.token}", Host="[")[0] == 403
    before = threading.active_count()
    with socket.create_connection(("127.0.0.1", page.port)) as visitor:
        visitor.sendall(b"GET /?tok")
        visitor.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # closed by a reset
    until(lambda: threading.active_count() <= before)
    assert page._server.log.counts["page failed"] == 0
    monkeypatch.setattr(page_module, "status_page", lambda *_, **__: 1 / 0)
    with pytest.raises(http.client.RemoteDisconnected):
        ask(page, f"/?token={page.token}")
    until(lambda: page._server.log.counts["page failed"])
    assert capfd.readouterr().err == ""


def test_a_job_is_retried_from_the_page_itself_only(page: Page, tmp_path: Path) -> None:
    cookie = {"Cookie": f"ronnaplan_node={page.token}"}
    assert ask(page, "/retry", "POST", "job=1", Origin="http://evil.example", **cookie)[0] == 400
    assert ask(page, "/retry", "POST", "job=x", Origin=f"http://127.0.0.1:{page.port}", **cookie)[0] == 400
    with Index(tmp_path / "node-data") as index:
        assert index.rows("SELECT state FROM jobs") == [("refused",)]
        assert ask(page, "/retry", "POST", "job=1", Origin=f"http://127.0.0.1:{page.port}", **cookie)[0] == 303
        assert index.rows("SELECT state FROM jobs") == [("waiting",)]


def test_figures_are_in_prometheus_format(page: Page) -> None:
    status, content = ask(page, "/metrics", Authorization=f"Bearer {page.token}")
    assert status == 200
    line = re.compile(r'(# (HELP|TYPE) ronnaplan_\w+ .+|ronnaplan_\w+(\{\w+="[^"]*"(,\w+="[^"]*")*\})? [0-9.e+]+)')
    assert all(line.fullmatch(one) for one in content.splitlines())
    assert "ronnaplan_instances 1" in content
    assert 'ronnaplan_jobs{state="refused"} 1' in content


@needs_browser
def test_long_uids_and_paths_do_not_drive_the_page_off_the_screen(page: Page, tmp_path: Path) -> None:
    uid = "1.2.826.0.1.3680043.8.498." + "7" * 38
    with Index(configuration(tmp_path).data) as index:
        index.run("UPDATE series SET series_uid = ?", uid)
        index.run("UPDATE jobs SET reason = ?", f"/var/lib/ronnaplan/node-data/instances/{uid}/{uid} is no volume")

    def over(tab: Any) -> list[int]:
        tab.goto(f"http://127.0.0.1:{page.port}/?token={page.token}")
        found = []
        for width in (1280, 800, 390):
            tab.set_viewport_size({"width": width, "height": 800})
            found.append(int(tab.evaluate("document.documentElement.scrollWidth")) - width)
        return found

    with looking() as look:
        assert max(look(over)) <= 0
