"""Live readings over OpenIGTLink: messages of points and of tools, until the time is up or the stream ends.

pyigtl's client keeps only the newest message of a device, so the socket is read here and nothing is lost.
"""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

from ronnaplan.errors import InputError
from ronnaplan.tracking.clocks import LEAP_S, Clocks
from ronnaplan.tracking.fillers import flag_fillers
from ronnaplan.tracking.igtl_messages import Stream
from ronnaplan.tracking.recording import PointReading, Recording, StreamEnd, ToolReading

DEFAULT_PORT = 18944
CONNECT_S = 5.0
"""A server that is there answers within this, its name's look-up included."""
SILENCE_S = 2.0
"""Without a message for this long, the stream is said to have stopped, and a device without a new one is not seen."""
PAUSE_S, LONGEST_PAUSE_S = 0.5, 8.0
"""A server that is gone is tried again after so long at first, and at last."""
LONGEST_S = 86_400.0
"""No recording takes longer than a day."""
POLL_S = 0.1


@dataclass(frozen=True)
class _End:
    """Why a stream ended, and ``how``, which follows that in its note."""

    why: StreamEnd
    how: str

    @property
    def note(self) -> str:
        return f"{self.why.value}{self.how}"


def moments(
    host: str,
    port: int = DEFAULT_PORT,
    *,
    every_s: float,
    seconds: float,
    resting: Collection[str] | None = None,
    clocks: Clocks | None = None,
) -> Iterator[Recording]:
    """Yield what a server at ``host`` sends in every ``every_s`` of its own time, for up to ``seconds`` of ours.

    A message that states no time counts as of its arrival. The last recording says why the stream ended before the
    time was up, if it did; a stream whose own time stands still, or a device's leaps back by more than ``every_s``, or
    `LEAP_S`, has ended. Where the time is up, a moment that had only begun is left out: of its last frame there may be
    the points and not yet the tools. Readings that a device repeats are flagged, as `Stream` does with ``resting``,
    and late ones by ``clocks``, which may be an earlier connection's. Raises `InputError` if no server answers.
    """
    stream, until = Stream(SILENCE_S, resting, clocks), time.monotonic() + seconds
    source, cut, told = f"openigtlink://{host}:{port}", _Moments(every_s), False
    with _connected(host, port) as connection:
        connection.settimeout(POLL_S)
        end, count, heard_s, told_s = None, 0, time.monotonic(), time.monotonic()
        said: list[str] = []
        while end is None and time.monotonic() < until:
            end = _receive(connection, stream, min(until, time.monotonic() + POLL_S))
            now = time.monotonic()
            if stream.messages > count:
                count, heard_s = stream.messages, now
            if stream.leapt_s > min(every_s, LEAP_S):  # a moment would be of both times
                end = _stopped(f"its own time leapt back by {stream.leapt_s:.1f} s after {count} messages")
                break
            untold = [note for note in stream.clocks.notes if note not in said]
            for points, tools in cut.add(stream.taken()):
                yield Recording(source, points, tools, notes=tuple(untold))
                said, untold = [*said, *untold], []
                told, told_s = True, time.monotonic()
            if end is None and now - heard_s > SILENCE_S:
                end = _silent(count)
            elif end is None and now - told_s > every_s + SILENCE_S and not untold:
                end = _stopped(f"its own time stands still after {count} messages")
    notes = (*stream.notes, *([end.note] if end else []))
    points, tools = ((), ()) if told and end is None else cut.rest()
    yield Recording(source, points, tools, notes=notes, end=end.why if end else None)


def rejoined_moments(
    host: str,
    port: int = DEFAULT_PORT,
    *,
    every_s: float,
    seconds: float,
    resting: Collection[str] | None = None,
    rejoin_s: float,
) -> Iterator[Recording]:
    """Yield `moments`, and join the server again where its stream ends before the time is up.

    That is tried after `PAUSE_S`, and after twice as long each time up to `LONGEST_PAUSE_S`, until there was no moment
    for ``rejoin_s``. Each end is told; what a device said before it counts no more, but how late it was does.
    """
    clocks = Clocks(SILENCE_S)
    until, pause_s, joined = time.monotonic() + seconds, PAUSE_S, False
    tried_until = time.monotonic() + rejoin_s
    while True:
        try:
            left_s = until - time.monotonic()
            for recording in moments(host, port, every_s=every_s, seconds=left_s, resting=resting, clocks=clocks):
                joined = True
                if recording.end is None:
                    yield recording
                    pause_s, tried_until = PAUSE_S, time.monotonic() + rejoin_s
                else:
                    again = f"; it is tried again for {rejoin_s:g} s" if rejoin_s else ""
                    yield replace(recording, notes=(*recording.notes[:-1], f"{recording.notes[-1]}{again}"))
            if recording.end is None:
                return
        except InputError:
            if not joined:
                raise
        if time.monotonic() + pause_s > min(until, tried_until):
            return
        time.sleep(pause_s)
        pause_s = min(2 * pause_s, LONGEST_PAUSE_S)


class _Moments:
    """Shares readings out among moments of equal length, by their own time.

    Those that state none are of the time that the one before them stated, and what has gone by since it came.
    """

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._end_s: float | None = None
        self._ahead_s: float | None = None
        """Of this computer's clock; None until a time was stated."""
        self._waiting: list[tuple[float, PointReading | ToolReading]] = []

    def add(
        self, readings: Sequence[PointReading | ToolReading]
    ) -> Iterator[tuple[tuple[PointReading, ...], tuple[ToolReading, ...]]]:
        """Take readings in the order in which they came, and yield those of each moment that is over."""
        now = time.monotonic()
        for one in readings:
            if one.time_s > 0:
                self._set(one.time_s - now)
            self._waiting.append((one.time_s if one.time_s > 0 else now + (self._ahead_s or 0.0), one))
        while self._waiting:
            if self._end_s is None:
                self._end_s = min(at for at, _ in self._waiting) + self._every_s
            if max(at for at, _ in self._waiting) < self._end_s:
                return
            before = [one for at, one in self._waiting if at < self._end_s]
            self._waiting = [(at, one) for at, one in self._waiting if at >= self._end_s]
            self._end_s = None
            yield _apart(before)

    def _set(self, ahead_s: float) -> None:
        """Keep how far ahead a sender's clock is; what came before any time was stated is placed by the first."""
        if self._ahead_s is None:
            self._waiting = [(at + ahead_s, one) for at, one in self._waiting]
            self._end_s = None if self._end_s is None else self._end_s + ahead_s
        self._ahead_s = ahead_s

    def rest(self) -> tuple[tuple[PointReading, ...], tuple[ToolReading, ...]]:
        """Return the readings of the moment that is not over."""
        return _apart([one for _, one in self._waiting])


def _apart(
    readings: Sequence[PointReading | ToolReading],
) -> tuple[tuple[PointReading, ...], tuple[ToolReading, ...]]:
    points = tuple(one for one in readings if isinstance(one, PointReading))
    return points, tuple(one for one in readings if isinstance(one, ToolReading))


def record(host: str, port: int = DEFAULT_PORT, *, seconds: float = 5.0) -> Recording:
    """Record all messages of points and tools that a server at ``host`` sends within ``seconds``.

    A POINT message is one tracker frame of (labelled or stray) markers; TRANSFORM and POSITION are a tool's pose,
    named by its device; TDATA and QTDATA are those of several tools, each with a name. If the stream stops or breaks,
    or Ctrl-C is pressed, what came until then is returned, with a note that says so. Raises `InputError` if no server
    answers or no message arrives at all.
    """
    if not math.isfinite(seconds) or not 0 < seconds <= LONGEST_S:
        raise InputError(f"{seconds} seconds were asked for; expected a time above zero and up to {LONGEST_S:g} s")
    stream = Stream(SILENCE_S)
    with _connected(host, port) as connection:
        connection.settimeout(POLL_S)
        end = None
        try:
            end = _receive(connection, stream, time.monotonic() + seconds)
            told = [end.note] if end else []
        except KeyboardInterrupt:
            if not stream.messages:
                raise
            told = [f"stopped by hand after {stream.messages} messages"]
    if not stream.messages:
        why = "; ".join([*told, *stream.passed_over, *stream.notes])
        raise InputError(f"{host}:{port} sent no readable message in {seconds:g} s{f' ({why})' if why else ''}")
    return flag_fillers(
        Recording(
            f"openigtlink://{host}:{port}",
            tuple(stream.points),
            tuple(stream.tools),
            notes=(*stream.notes, *told),
            end=end.why if end else None,
        )
    )


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


def _silent(messages: int) -> _End:
    return _stopped(f"silent for {SILENCE_S:g} s after {messages} messages")


def _stopped(how: str) -> _End:
    return _End(StreamEnd.STOPPED, f": {how}")


def _receive(connection: socket.socket, stream: Stream, until: float) -> _End | None:
    """Feed ``stream`` until the time is up; return why it ended early, if it did."""
    last = time.monotonic()
    while time.monotonic() < until:
        try:
            data = connection.recv(1 << 16)
        except TimeoutError:
            if time.monotonic() - last > SILENCE_S:
                return _silent(stream.messages)
            continue
        except OSError as error:
            return _stopped(f"the connection broke after {stream.messages} messages ({error})")
        if not data:
            rest = " in the middle of a message" if stream.pending else ""
            return _End(StreamEnd.CLOSED, f" after {stream.messages} messages{rest}")
        last = time.monotonic()
        stream.feed(data)
        if stream.broken:
            return _stopped(stream.broken)
    return None
