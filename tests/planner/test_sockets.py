"""No page can take the planner's memory, stop it, or keep the others waiting."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from pathlib import Path

import aiohttp
import msgpack
import pytest

from ronnaplan.planner.sockets import MOST_MESSAGE_BYTES, MOST_PAGES, MOST_WAITING_BYTES, Outbox, read_request
from tests.loops import run
from tests.planner.browser import Planner
from tests.planner.pages import HELLO, Page, frame, request

GIB = 2**30
HOSTILE = {
    "claims 4 GB": frame(b"\x80", size=2**32 - 1),
    "claims 1 GB": frame(b"\x80", size=GIB),
    "begins behind its end": frame(b"\x80", offset=2**31, size=1),
    "claims nothing": frame(b"\x80", size=0),
    "no content": frame(b""),
    "half a header": b"\x00" * 7,
    "nothing": b"",
    "too long": frame(
        msgpack.packb({"id": "rpc:1", "method": "trame.state.get", "args": ["x" * MOST_MESSAGE_BYTES]})
    ),
    "nested 10,000 deep": frame(b"\x91" * 10_000 + b"\x01"),
    "no msgpack": frame(b"\xc1"),
    "no map": frame(msgpack.packb([1, 2])),
    "a number for the id": frame(msgpack.packb({"id": 1, "method": "trame.state.get"})),
    "a list for the method": frame(msgpack.packb({"id": "rpc:1", "method": ["trame.state.get"]})),
    "ends the server": request("application.exit"),
    "ends the server later": request("application.exit.later", 0),
    "pushes any value": request("trame.force.push", "picture_axial"),
    "a life of its own": request("trame.lifecycle.update", "server_exited"),
    "a list for a name": request("trame.trigger", ["press"], [], {}),
    "a name that writes to the terminal": request("trame.trigger", "\x1b[31m", [], {}),
    "a map for arguments": request("trame.trigger", "press", {"view": "axial"}, {}),
    "named arguments": request("trame.trigger", "press", [], {"view": "axial"}),
    "too few": request("trame.trigger"),
    "too many": request("trame.state.get", 1),
    "a number for a key": request("trame.state.update", [{"key": 5, "value": 1}]),
    "text for changes": request("trame.state.update", "key"),
    "a number for a secret": request("wslink.hello", {"secret": 5}, number="system:c0:0"),
}

WORST = (
    *("claims 4 GB", "claims nothing", "half a header", "too long", "nested 10,000 deep", "no map"),
    *("ends the server", "pushes any value", "a life of its own", "a map for arguments", "a number for a key"),
)
"""One of each kind: all are refused in one place, and each takes a page of its own to be sent to a planner."""


@pytest.mark.parametrize("sent", HOSTILE.values(), ids=HOSTILE.keys())
def test_what_our_page_does_not_send_is_refused_before_it_is_unpacked(sent: bytes) -> None:
    with pytest.raises(ValueError, match="expected"):
        read_request(sent)


def test_what_our_page_sends_is_taken_as_it_is() -> None:
    assert read_request(HELLO)["args"] == [{"secret": "wslink-secret"}]
    asked = read_request(request("trame.trigger", "press", ["axial", 1.5, 2, 3, 4, 0, False], {}))
    assert (asked["method"], asked["args"][:2]) == ("trame.trigger", ["press", ["axial", 1.5, 2, 3, 4, 0, False]])


class Silent:
    """A page that takes nothing."""

    closed = False

    async def send_bytes(self, chunk: bytes) -> None:
        await asyncio.Event().wait()


def test_a_page_that_takes_nothing_is_cut_off_and_nobody_waits_for_it() -> None:
    async def send() -> list[str]:
        ended: list[str] = []
        outbox = Outbox(Silent(), lambda: ended.append("cut off"))  # type: ignore[arg-type]
        chunk = bytes(2**20)
        for _ in range(MOST_WAITING_BYTES // len(chunk)):
            await asyncio.wait_for(outbox.send_bytes(chunk), 1)
        assert ended == []
        await outbox.send_bytes(chunk)
        await asyncio.sleep(0)
        await outbox.send_bytes(chunk)
        return ended

    assert run(send()) == ["cut off"]


def test_a_page_that_takes_a_chunk_too_slowly_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ronnaplan.planner.sockets.SLOWEST_SEND_S", 0.01)

    async def send() -> None:
        ended = asyncio.Event()
        outbox = Outbox(Silent(), ended.set)  # type: ignore[arg-type]
        await outbox.send_bytes(b"x")
        await asyncio.wait_for(ended.wait(), 60)

    run(send())


def resident_bytes(planner: Planner) -> int:
    status = Path(f"/proc/{planner.process.pid}/status")
    if not status.exists():
        pytest.skip("memory of another process is read from /proc, which is not here")
    lines = (line.split() for line in status.read_text().splitlines())
    return next(int(words[1]) * 1024 for words in lines if words[0] == "VmHWM:")


def test_hostile_pages_are_closed_and_take_no_memory_while_others_are_served(kept: Planner) -> None:
    async def attack() -> None:
        async with Page(kept.url) as watching:
            for name in WORST:
                async with Page(kept.url) as hostile:
                    assert await hostile.is_cut_off(HOSTILE[name]), name
                assert "result" in await watching.trigger("window", "bone"), name
            async with Page(kept.url) as hostile:
                assert await hostile.is_cut_off("text where bytes are expected")
            assert (await watching.state())["trame__title"] == "ronnaplan"

    before = resident_bytes(kept)
    run(attack())
    assert kept.process.poll() is None
    assert resident_bytes(kept) - before < GIB / 4


def test_a_page_that_stops_reading_holds_up_no_other(kept: Planner) -> None:
    async def attack() -> None:
        async with Page(kept.url) as watching, Page(kept.url) as silent:
            for _ in range(150):
                await silent.socket.send_bytes(request("trame.state.get"))
            for _ in range(3):
                assert "result" in await watching.trigger("window", "bone")

    run(attack())


def test_more_pages_than_anyone_opens_are_refused(kept: Planner) -> None:
    async def attack() -> None:
        async with AsyncExitStack() as pages:
            for _ in range(MOST_PAGES):
                await pages.enter_async_context(Page(kept.url))
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await pages.enter_async_context(Page(kept.url))
            assert refused.value.status == 503
        async with Page(kept.url) as page:
            assert "result" in await page.trigger("window", "bone")

    run(attack())
