"""What the node says: one JSON object a line, with a time and an event, and never a patient's name unless asked."""

from __future__ import annotations

import json
import sys
import threading
from collections import Counter
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, TextIO

from ronnaplan.text import LONGEST_SENTENCE, printable

LISTENING = "listening"
"""The event that tells that peers can send."""


class Log:
    """Writes events to ``stream``; ``counts`` says how many there were of each kind."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream
        self._lock = threading.Lock()
        self.counts: Counter[str] = Counter()

    def tell(self, event: str, **facts: Any) -> None:
        """Write ``event`` with its ``facts``; what nobody can read is dropped, as nothing depends on it."""
        line = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "event": event}
        line |= {
            key: printable(value, LONGEST_SENTENCE) if isinstance(value, str) else value
            for key, value in facts.items()
        }
        self._write(event, json.dumps(line, default=str))

    def relay(self, line: str) -> str:
        """Write a line that another process of the node told and return its event; what is none of a log is dropped."""
        try:
            event = str(json.loads(line)["event"])
        except (ValueError, KeyError, TypeError):
            return ""
        self._write(event, line.rstrip("\n"))
        return event

    def _write(self, event: str, line: str) -> None:
        stream = self._stream or sys.stderr
        with self._lock:
            self.counts[event] += 1
            with suppress(OSError, ValueError):  # closed, or full
                print(line, file=stream, flush=True)
