"""OpenIGTLink's bytes cut into messages, and the readings in them (http://openigtlink.org/protocols).

pyigtl checks the sums. Its unpacking is not used: one name that is not UTF-8 ends its stream, and its POSITION layout
is not the protocol's (seven float32), so both layouts are understood here.
"""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pyigtl.messages import CRC64

from ronnaplan.geometry import FloatArray
from ronnaplan.text import printable
from ronnaplan.tracking.clocks import Clocks
from ronnaplan.tracking.igtl_layout import (
    HEADER,
    PLACE_BYTES,
    POINT_ITEM,
    TRACKED_ITEMS,
    Message,
    doubles,
    matrix_of,
    pose_status,
    positions,
    text,
    tracked,
)
from ronnaplan.tracking.recording import (
    NO_POSE,
    NO_POSITION,
    OK,
    PointReading,
    Roundings,
    ToolReading,
    flagged,
    quaternion_pose,
    tool_reading,
)

REPEATED = "repeated to the last digit: its device sends nothing new"
"""Status of a good reading whose device has long sent the same: it is of a moment that is over."""
MOST_READINGS = 1_000_000
"""A recording that holds more (0.8 GB of memory) is ended: half a day of one tool at 20 Hz."""
MOST_NAMES = 1000
"""No tracker has more devices or tools, and no stream more kinds of faults: each is remembered."""
MOST_NOTES = 20
"""Faults that are told one by one, the commonest; of the others only how many there were."""
MOST_KINDS = 5
"""Kinds of messages that are named among those that were passed over."""


class Stream:
    """Cuts the bytes of a connection into messages and collects their readings.

    Where a device goes on sending, but the same with the same time for ``silence_s``, its readings are flagged. With
    ``resting`` they are whatever its time, but for the devices of these names: what a tracker reads is never the same
    twice, to the last digit, so that this is a copy under a new time; a robot at rest tells the same. So are, then,
    readings that come more than ``silence_s`` later after their own time than the quickest of their device did; a time
    that never was another one counts as none.
    """

    def __init__(
        self, silence_s: float, resting: Collection[str] | None = None, clocks: Clocks | None = None
    ) -> None:
        self._silence_s, self._resting = silence_s, resting
        self.points: list[PointReading] = []
        self.tools: list[ToolReading] = []
        self._untaken: list[PointReading | ToolReading] = []
        self.messages = 0
        self.broken: str | None = None
        self.leapt_s = 0.0
        """How far the time of a device's messages leapt back at most; each counts by itself, as clocks differ."""
        self._latest: dict[tuple[str, str, str], tuple[float, int, float]] = {}
        """Of each device's points, and of each of its tools: their last time, a hash of what it said, and when, by this
        computer's clock, that was new."""
        self._left_out: Counter[str] = Counter()
        self._passed_over: Counter[str] = Counter()
        self._roundings = Roundings()
        self._buffer = bytearray()
        self._next: Message | None = None
        self.clocks = Clocks(silence_s) if clocks is None else clocks
        """Of what is watched."""
        self._point_frames = 0
        self._tool_frames: Counter[str] = Counter()
        self._told_by: dict[str, tuple[str, float]] = {}
        """Of each tool, the messages that told it first, and when, by this computer's clock, they last did."""

    @property
    def pending(self) -> bool:
        """Whether a message has begun that is not there in full."""
        return bool(self._buffer) or self._next is not None

    @property
    def notes(self) -> list[str]:
        """What was left out and how far poses were off, one sentence each."""
        told = [f"{count} {what}" for what, count in self._left_out.most_common(MOST_NOTES)]
        others = sum(self._left_out.values()) - sum(count for _, count in self._left_out.most_common(MOST_NOTES))
        if others:
            told.append(f"{others} more messages were left out for other reasons")
        return [*told, *self._roundings.notes]

    @property
    def passed_over(self) -> list[str]:
        """What came of other kinds than those that are read, in a sentence where there is any."""
        told = ", ".join(f"{count} {kind}" for kind, count in self._passed_over.most_common(MOST_KINDS))
        return [f"{told} came; POINT, TRANSFORM, POSITION, TDATA and QTDATA are read"] if told else []

    def taken(self) -> list[PointReading | ToolReading]:
        """Return the readings that came since this was last asked, in their order, and keep them no longer."""
        taken, self._untaken, self.points, self.tools = self._untaken, [], [], []
        return taken

    def feed(self, data: bytes) -> None:
        """Take the readings of every message that ``data`` completes; ``broken`` says why no more can follow."""
        self._buffer += data
        while not self.broken:
            if self._next is None:
                if len(self._buffer) < HEADER.size:
                    return
                try:
                    self._next = Message.of_header(bytes(self._buffer[: HEADER.size]))
                except ValueError as error:
                    self.broken = f"the stream is not OpenIGTLink ({error}) after {self.messages} messages"
                    return
                del self._buffer[: HEADER.size]
            if len(self._buffer) < self._next.length:
                return
            body = bytes(self._buffer[: self._next.length])
            del self._buffer[: self._next.length]
            message, self._next = self._next, None
            self._take(message, body)
            if len(self.points) + len(self.tools) >= MOST_READINGS:
                self.broken = f"{MOST_READINGS} readings came, the most that are kept; record for a shorter time"
            elif self._names > MOST_NAMES:
                self.broken = (
                    f"{self._names} names of devices, tools or faults came in {self.messages} messages; expected "
                    f"{MOST_NAMES} at most, so let the sender call each device alike in all its messages"
                )

    @property
    def _names(self) -> int:
        """How many names the longest table holds."""
        tables = (self._tool_frames, self._left_out, self._passed_over)
        return max(len(self._latest), len(self.clocks), *(len(table) for table in tables))

    def _take(self, message: Message, body: bytes) -> None:
        unpack = {"POINT": self._take_points, "TRANSFORM": self._take_transform}
        unpack |= dict.fromkeys(("POSITION", "QTRANS"), self._take_positions)  # two names of one kind
        unpack |= dict.fromkeys(TRACKED_ITEMS, self._take_tracked)
        if message.kind not in unpack:
            self._passed_over[message.kind] += 1
            return
        what = _sender(message)
        if message.checksum not in (0, CRC64(body)):
            self._left_out[f"{what} failed their checksum and were left out"] += 1
            return
        points, tools = len(self.points), len(self.tools)
        over = None
        if self._resting is not None and message.time_s > 0:
            over = self.clocks.heard(what, message.time_s, time.monotonic())
            message = replace(message, time_s=0.0) if what in self.clocks.none else message
        try:
            unpack[message.kind](message, body)
        except (ValueError, struct.error) as error:
            self._left_out[f"{what} cannot be read ({error}) and were left out"] += 1
            return
        self.messages += 1
        self.tools[tools:] = [self._marked(one, message) for one in self.tools[tools:]]
        places = b"".join(one.position_mm.tobytes() for one in self.points[points:])
        if places and self._is_repeated(message, "", places):
            self.points[points:] = flagged(self.points[points:], REPEATED)
        if over is not None:
            self.points[points:] = flagged(self.points[points:], over)
            self.tools[tools:] = flagged(self.tools[tools:], over)
        self._untaken += [*self.points[points:], *self.tools[tools:]]

    def _marked(self, one: ToolReading, message: Message) -> ToolReading:
        """Return a reading, flagged where its tool has long been the same: others of its message may be new.

        So is one of other messages than told its tool before: these may mean another frame, and the tool stays theirs.
        """
        pose = b"" if one.matrix is None else one.matrix.tobytes()
        status = REPEATED if self._is_repeated(message, one.tool, pose) else OK
        first, _ = self._told_by[one.tool]
        if first != _sender(message):
            status = f"told by {_sender(message)} only, since {first} fell silent"
        return replace(one, status=status) if status != OK and one.usable else one

    def _is_repeated(self, message: Message, tool: str, said_of_it: bytes) -> bool:
        """Keep what a device said last of a ``tool``, or of points (""); return whether that has long been the same.

        A frozen device says so. Places that change are new though the device's time stands still: some senders
        never set it again.
        """
        may_rest = self._resting is None or tool in self._resting
        if message.time_s <= 0 and may_rest:  # 0 states none
            return False
        sender, now, said = (message.kind, message.device, tool), time.monotonic(), hash(said_of_it)
        latest_s, before, new_s = self._latest.get(sender, (0.0, said, now))
        if message.time_s > 0:
            self.leapt_s = max(self.leapt_s, latest_s - message.time_s)
        if said != before or (may_rest and message.time_s > latest_s):
            new_s = now
        self._latest[sender] = message.time_s, said, new_s
        return now - new_s > self._silence_s

    def _take_points(self, message: Message, body: bytes) -> None:
        content = message.content(body)
        if len(content) % POINT_ITEM.itemsize:
            raise ValueError(f"{len(content)} bytes")
        items: NDArray[np.void] = np.frombuffer(content, dtype=POINT_ITEM)
        for name, place in zip(items["name"].tolist(), doubles(items["place"]), strict=True):
            self._add_place(message, text(name), place, OK)
        self._point_frames += 1

    def _take_transform(self, message: Message, body: bytes) -> None:
        content, status = message.content(body), pose_status(message.metadata(body))
        if len(content) != 48:
            raise ValueError(f"{len(content)} bytes")
        matrix = matrix_of(doubles(np.frombuffer(content, dtype=">f4")))
        tool = message.device
        if not self._is_new(message, tool):
            return
        self._add_pose(self._next_frame(tool), tool, matrix, message.time_s, status)

    def _take_tracked(self, message: Message, body: bytes) -> None:
        told, content = message.metadata(body), message.content(body)
        found = [
            one
            for one in tracked(message.kind, content, message.device)
            if one.is_place or self._is_new(message, one.name)
        ]
        # one moment's, where a tool was left out before, too
        frame = max((self._tool_frames[one.name] for one in found), default=0)
        for one in found:
            stated = pose_status(told, one.name)
            status = one.status if stated == OK else stated
            if one.is_place:
                self._add_place(message, one.name, one.place_mm, status)
            else:
                self._tool_frames[one.name] = frame + 1
                self._add_pose(frame, one.name, one.matrix, message.time_s, status)
        self._point_frames += any(one.is_place for one in found)

    def _add_pose(self, frame: int, tool: str, matrix: FloatArray | None, time_s: float, status: str) -> None:
        if matrix is None:
            status = NO_POSE if status == OK else status
            self.tools.append(ToolReading(frame, tool, None, time_s, None, status))
            return
        reading, excess = tool_reading(frame, tool, matrix, time_s, status)
        self.tools.append(reading)
        self._roundings.add(excess)

    def _take_positions(self, message: Message, body: bytes) -> None:
        stated, content = pose_status(message.metadata(body)), message.content(body)
        if len(content) == PLACE_BYTES:
            self._add_place(message, message.device, doubles(np.frombuffer(content, dtype=">f4")), stated)
            self._point_frames += 1
            return
        for name, position, quaternion in positions(content):
            tool = name or message.device
            if self._is_new(message, tool):
                pose = quaternion_pose(quaternion, position)
                self._add_pose(self._next_frame(tool), tool, pose, message.time_s, stated)

    def _add_place(self, message: Message, label: str, place_mm: FloatArray, stated: str) -> None:
        """Take a place (3,) for a point, a tool's, too, that came without its rotation: none is made up."""
        status = stated if stated != OK or np.isfinite(place_mm).all() else NO_POSITION
        self.points.append(
            PointReading(self._point_frames, place_mm, label, message.time_s, None, status, message.device)
        )

    def _is_new(self, message: Message, tool: str) -> bool:
        """Whether a tool's reading is no second one of what messages of another kind, or device, tell of it."""
        sender, now = _sender(message), time.monotonic()
        called = printable(tool, len(tool))  # as readings are
        first, heard_s = self._told_by.setdefault(called, (sender, now))
        if first == sender:
            self._told_by[called] = first, now
        elif now - heard_s <= self._silence_s:
            self._left_out[f"readings of {tool} in {sender} were left out: {first} tell of it, too"] += 1
            return False
        return True

    def _next_frame(self, tool: str) -> int:
        self._tool_frames[tool] += 1
        return self._tool_frames[tool] - 1


def _sender(message: Message) -> str:
    return f"{message.kind} messages of {message.device}"
