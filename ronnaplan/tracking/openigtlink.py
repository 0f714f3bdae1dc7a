"""Live readings over OpenIGTLink: POINT, TRANSFORM and POSITION messages, until the time is up or the stream ends.

pyigtl's client keeps only the newest message of a device, so the socket is read here and nothing is lost.
"""

from __future__ import annotations

import math
import socket
import threading
import time

from ronnaplan.errors import InputError
from ronnaplan.tracking.igtl_messages import Stream
from ronnaplan.tracking.recording import Recording

DEFAULT_PORT = 18944
CONNECT_S = 5.0
"""A server that is there answers within this, its name's look-up included."""
SILENCE_S = 2.0
"""Without a message for this long, the stream is said to have stopped."""
LONGEST_S = 86_400.0
"""No recording takes longer than a day."""
POLL_S = 0.1


def record(host: str, port: int = DEFAULT_PORT, *, seconds: float = 5.0) -> Recording:
    """Record all POINT, TRANSFORM and POSITION messages a server at ``host`` sends within ``seconds``.

    A POINT message is one tracker frame of (labelled or stray) markers; TRANSFORM and POSITION are a tool's pose,
    named by its device. If the stream stops or breaks, or Ctrl-C is pressed, what came until then is returned, with
    a note that says so. Raises `InputError` if no server answers or no message arrives at all.
    """
    if not math.isfinite(seconds) or not 0 < seconds <= LONGEST_S:
        raise InputError(f"{seconds} seconds were asked for; expected a time above zero and up to {LONGEST_S:g} s")
    stream = Stream()
    with _connected(host, port) as connection:
        connection.settimeout(POLL_S)
        try:
            note = _receive(connection, stream, time.monotonic() + seconds)
        except KeyboardInterrupt:
            if not stream.messages:
                raise
            note = f"stopped by hand after {stream.messages} messages"
    if not stream.messages:
        why = "; ".join([*([note] if note else []), *stream.notes])
        raise InputError(f"{host}:{port} sent no readable message in {seconds:g} s{f' ({why})' if why else ''}")
    notes = stream.notes + ([note] if note else [])
    return Recording(f"openigtlink://{host}:{port}", tuple(stream.points), tuple(stream.tools), notes=tuple(notes))


def _connected(host: str, port: int) -> socket.socket:
    """Return a connection; raises `InputError` when there is none within `CONNECT_S`.

    It is made in a thread, since the look-up of a name can be neither limited nor interrupted.
    """
    made: list[socket.socket] = []
    failed: list[Exception] = []

    def connect() -> None:
        try:
            made.append(socket.create_connection((host, port), timeout=CONNECT_S))
        except (OSError, OverflowError, ValueError) as error:  # UnicodeError of a host's name is a ValueError
            failed.append(error)

    thread = threading.Thread(target=connect, daemon=True)
    thread.start()
    thread.join(CONNECT_S)
    if made:
        return made[0]
    reason = failed[0] if failed else f"nothing within {CONNECT_S:g} s"
    raise InputError(f"no OpenIGTLink server answers at {host}:{port} ({reason}); start it, check host and port")


def _receive(connection: socket.socket, stream: Stream, until: float) -> str | None:
    """Feed ``stream`` until the time is up; return why it ended early, if it did."""
    last = time.monotonic()
    while time.monotonic() < until:
        try:
            data = connection.recv(1 << 16)
        except TimeoutError:
            if time.monotonic() - last > SILENCE_S:
                return f"the stream stopped: silent for {SILENCE_S:g} s after {stream.messages} messages"
            continue
        except OSError as error:
            return f"the connection broke after {stream.messages} messages ({error})"
        if not data:
            rest = " in the middle of a message" if stream.pending else ""
            return f"the server closed the stream after {stream.messages} messages{rest}"
        last = time.monotonic()
        stream.feed(data)
        if stream.broken:
            return stream.broken
    return None
