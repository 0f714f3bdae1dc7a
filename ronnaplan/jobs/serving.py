"""The loop of a child process that works. Orders are JSON, a line of standard input each; what is done is told alike.

``ready`` is told once it can begin; ``ended``, with a state and a reason, when there is no more of an order. A fault
that ``passes`` is none of the order's, as of a disk without room.
"""

from __future__ import annotations

import json
import queue
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from ronnaplan.ct.limits import MIB
from ronnaplan.errors import NO_ROOM, RonnaplanError, UnwrittenError
from ronnaplan.jobs.processes import end_with_parent

DONE, REFUSED, BROKEN = "done", "refused", "broken"
"""How a job ends: with answers, with a reason that no second attempt would change, or by a fault."""


def heard(line: str) -> dict[str, Any] | None:
    """Return what a child told in a line; None for what a library prints, or a line torn by the child's death."""
    try:
        told = json.loads(line)
    except ValueError:
        return None
    return told if isinstance(told, dict) and "event" in told else None


class Tell(Protocol):
    """Tells the parent an event of a job, with facts."""

    def __call__(self, event: str, **facts: Any) -> None:
        """Write a line."""
        ...


def serve(
    memory_mib: int,
    warm_up: Callable[[], None],
    work: Callable[[dict[str, Any], Tell], None],
    begun: dict[str, Any] | None = None,
) -> int:
    """Work, within so much memory, until the parent closes this process's standard input, or dies.

    ``work`` tells ``ended`` itself, unless it raises. An order is an object with its ``job``'s number. One that was
    ``begun`` in this process, by another program, is worked on first; then this one is not told to be ready.
    """
    from ronnaplan.portable import limit_memory

    orders: queue.SimpleQueue[str] = queue.SimpleQueue()
    output, sys.stdout = sys.stdout, sys.stderr  # what a library prints is no answer

    def tell(event: str, **facts: Any) -> None:
        with suppress(BrokenPipeError):  # of a parent that was killed: this process ends, too
            # a compiled library's own output may have left a line unfinished
            print(f"\n{json.dumps({'event': event, **facts})}", file=output, flush=True)

    threading.Thread(target=_serve, args=(orders, tell, warm_up, work, begun), daemon=True).start()
    limit_memory(memory_mib * MIB)
    end_with_parent(orders.put)
    return 0


def _serve(
    orders: queue.SimpleQueue[str],
    tell: Tell,
    warm_up: Callable[[], None],
    work: Callable[[dict[str, Any], Tell], None],
    begun: dict[str, Any] | None,
) -> None:
    if begun is None:
        warm_up()
        tell("ready")
    while True:
        order, begun = begun or json.loads(orders.get()), None
        try:
            work(order, tell)
        except UnwrittenError as error:  # there may be room later
            tell("ended", job=order["job"], state=BROKEN, reason=str(error), passes=True)
        except RonnaplanError as error:
            tell("ended", job=order["job"], state=REFUSED, reason=str(error))
        except Exception as error:  # whatever it is, it is this job's: told, and tried again
            passes = isinstance(error, OSError) and error.errno in NO_ROOM
            reason = f"{type(error).__name__}: {error}"
            tell("ended", job=order["job"], state=BROKEN, reason=reason, passes=passes)
