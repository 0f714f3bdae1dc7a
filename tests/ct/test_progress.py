import os
import struct
import sys

import pytest

from ronnaplan.ct.progress import advancing


def test_a_long_read_shows_a_bar_on_a_terminal_and_passes_every_item_on(monkeypatch: pytest.MonkeyPatch) -> None:
    pty = pytest.importorskip("pty", reason="Windows has no such terminal")
    import fcntl
    import termios

    try:
        reading_end, terminal = pty.openpty()
    except OSError as error:
        pytest.skip(f"this machine has no terminal to show a bar on ({error})")
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    with os.fdopen(terminal, "w") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        monkeypatch.setattr("ronnaplan.ct.progress.DELAY_S", 0.0)
        assert list(advancing(range(5), 5, True, "reading slices")) == [0, 1, 2, 3, 4]
        shown = os.read(reading_end, 4096)
    os.close(reading_end)
    assert b"reading slices" in shown


def test_without_a_wish_for_it_there_is_no_bar() -> None:
    items = [1, 2]
    assert advancing(items, 2, False, "slices") is items
