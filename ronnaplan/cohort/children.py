"""What a Dask worker runs: each series in a child process, which may hang, die or take too much without any harm.

A child is kept for the next series; one that did not end its work is not.
"""

from __future__ import annotations

import json
import queue
import signal
import threading
import time
from typing import Any, Final

from ronnaplan.jobs.processes import Child
from ronnaplan.jobs.serving import BROKEN, heard

WORKER: Final = "ronnaplan.cohort.work"
MOST_ORDERS: Final = 200
"""Series that one child works on before a fresh one takes its place."""
READY_S: Final = 300.0
"""How long a child may take to begin: on a crowded machine its imports take long."""
IDLE_S: Final = 60.0
"""A child that gets no work for so long ends: whoever sent it may have gone without a word."""
POLL_S: Final = 0.2
"""While a child says nothing, so often it is looked whether it has ended."""
ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""There are as many children as cores."""

Outcome = dict[str, Any]
"""``state``, ``reason``, ``is_lost`` (its process died, which may be nobody's fault), ``parts``, ``seconds``."""


class _Hand:
    """A child and what it says."""

    def __init__(self, module: str, memory_mib: int) -> None:
        self._said: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.kind = (module, memory_mib)
        self.child = Child(module, [str(memory_mib)], self._said.put, ONE_THREAD)
        self.orders = 0
        self.is_ready = False
        self.end_of_idling = threading.Timer(IDLE_S, _let_go, [self])

    def hear(self, last: float) -> dict[str, Any] | None:
        """Return the next thing that it says; None once it has ended, or at the time ``last`` (monotonic)."""
        while (left := last - time.monotonic()) > 0:
            has_ended = self.child.status is not None
            try:
                told = heard(self._said.get(timeout=0 if has_ended else min(left, POLL_S)))
            except queue.Empty:
                if has_ended:
                    return None
            else:
                if told is not None:
                    return told
        return None


_idle: list[_Hand] = []
_busy: list[_Hand] = []
_lock = threading.Lock()


def work_on(order: dict[str, Any], limits: dict[str, Any], module: str = WORKER) -> Outcome:
    """Have an order worked on within ``limits`` (``seconds``, ``memory_mib``); whatever happens is an outcome."""
    hand = _taken(module, limits["memory_mib"])
    is_sound = False
    try:
        outcome = _worked(hand, order, limits)
        hand.orders += 1
        is_sound = outcome["state"] != BROKEN and hand.orders < MOST_ORDERS
    finally:
        with _lock:
            _busy.remove(hand)
            if is_sound:
                _idle.append(hand)
                hand.end_of_idling = threading.Timer(IDLE_S, _let_go, [hand])
                hand.end_of_idling.daemon = True
                hand.end_of_idling.start()
        if not is_sound:
            hand.child.kill()
            hand.child.end()
    return outcome


def _let_go(hand: _Hand) -> None:
    """End a child if it still waits for work."""
    with _lock:
        if hand not in _idle:
            return
        _idle.remove(hand)
    hand.child.kill()
    hand.child.end()


def dismiss(*, busy: bool = False) -> None:
    """End the children of this process that wait for work, and those that are ``busy``, whose work is then lost."""
    with _lock:
        gone = list(_idle)
        _idle.clear()
        for hand in gone:
            hand.end_of_idling.cancel()
        working = list(_busy) if busy else []
    for hand in working:
        hand.child.kill()  # who waits for it notices
    for hand in gone:
        hand.child.kill()
        hand.child.end()


def _taken(module: str, memory_mib: int) -> _Hand:
    with _lock:
        fitting = [one for one in _idle if one.kind == (module, memory_mib) and one.child.status is None]
        hand = fitting[0] if fitting else _Hand(module, memory_mib)
        if fitting:
            _idle.remove(hand)
            hand.end_of_idling.cancel()
        _busy.append(hand)
    return hand


def _worked(hand: _Hand, order: dict[str, Any], limits: dict[str, Any]) -> Outcome:
    if not hand.is_ready:
        told = hand.hear(time.monotonic() + READY_S)
        if told is None:
            return _lost(hand, "its process did not begin")
        hand.is_ready = True
    hand.child.say(json.dumps(order))
    begun = time.monotonic()
    last = begun + limits["seconds"]
    parts = []
    while (told := hand.hear(last)) is not None:
        if told.get("job") != order["job"]:
            continue
        if told["event"] == "part":
            parts.append(told)
        elif told["event"] == "ended":
            reason = told["reason"]
            if reason.startswith("MemoryError") or "ArrayMemoryError" in reason:
                reason = f"it took more memory than {limits['memory_mib']} MiB"
            measured = {"seconds": time.monotonic() - begun, "peak_bytes": told.get("peak_bytes")}
            return {**_outcome(told["state"], reason), "parts": parts, **measured}
    if hand.child.status is None:
        return _outcome(BROKEN, f"it took longer than {limits['seconds']:g} s")
    return _lost(hand, "its process died")


def _lost(hand: _Hand, what: str) -> Outcome:
    status = hand.child.status
    if status is None:
        why = f"within {READY_S:g} s"
    elif status < 0:
        known = {one.value: one.name for one in signal.Signals}
        why = f"by signal {known.get(-status, -status)}"
    else:
        why = f"with status {status}"
    return {**_outcome(BROKEN, f"{what} ({why})"), "is_lost": True}


def _outcome(state: str, reason: str) -> Outcome:
    return {"state": state, "reason": reason, "is_lost": False, "parts": [], "seconds": None, "peak_bytes": None}
