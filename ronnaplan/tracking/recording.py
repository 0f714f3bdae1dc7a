"""What an optical tracker reported, reading by reading. Nothing is dropped: a doubtful reading says why."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TypeVar

import numpy as np

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import FloatArray, Frame, require_sigma
from ronnaplan.pose import POSE_TOLERANCE, as_pose
from ronnaplan.text import printable
from ronnaplan.transforms import orthonormality_excess

OK = "ok"
"""Status of a reading that its source calls good."""
NO_STATUS = "no status"
"""Status of a reading whose source keeps one and left it empty: that does not call it good."""
NO_POSITION, NO_POSE = "no position", "no pose"
"""Statuses of a reading without a place, or of a tool without a pose, of which nothing else is said."""
OTS = Frame("OTS")
QUATERNION = ("q0", "qx", "qy", "qz")
"""How tables name the columns of a rotation: the scalar first, then the vector."""
FARTHEST_MM = 1e6
"""No tracker sees a kilometre far: such a position is damage."""
QUATERNION_TOLERANCE = 1e-2
"""Largest departure from length one of a quaternion that still is a rotation (printed with few digits)."""

ROTATION_TOLERANCE = 2e-3
"""Largest entry of ``R @ R.T - 1`` of a tracker's matrix that still stands for a rotation, the nearest one: PLUS
writes matrices that are off by up to 5e-4 in an entry, a thousandth here. A tool scaled by 0.1 % is at the limit."""


class StreamEnd(Enum):
    """Why a live stream ended before its time was up."""

    CLOSED = "the server closed the stream"
    STOPPED = "the stream stopped"


@dataclass(frozen=True, eq=False)
class PointReading:
    """One sphere in one tracker frame. ``label`` is empty for a stray (unidentified) marker.

    Raises `InputError` for a position that has no three coordinates, and a good reading whose ``sigma_mm`` is no error.
    """

    frame: int
    position_mm: FloatArray
    """Position (3,) in the tracker's coordinates; NaN when the source gave none."""
    label: str = ""
    time_s: float = float("nan")
    sigma_mm: float | None = None
    """Standard deviation per axis, where the source states one."""
    status: str = OK
    device: str = ""
    """Which of a stream's devices sent it."""

    def __post_init__(self) -> None:
        _make_plain(self, "label", "status", "device")
        if np.shape(self.position_mm) != (3,):
            raise InputError(f"a reading's position has shape {np.shape(self.position_mm)}; expected (3,), in mm")
        if self.status == OK and self.sigma_mm is not None:
            require_sigma(self.sigma_mm, "a reading's error")

    @property
    def usable(self) -> bool:
        """Whether the source calls the reading good and it has a position."""
        return self.status == OK and _near(self.position_mm)


@dataclass(frozen=True, eq=False)
class ToolReading:
    """The pose of one tracked tool in one tracker frame."""

    frame: int
    tool: str
    matrix: FloatArray | None
    """Tracker from tool (4, 4), mm; None when the tool was not seen."""
    time_s: float = float("nan")
    error_mm: float | None = None
    """The tracker's own RMS misfit of the tool's markers."""
    status: str = OK

    def __post_init__(self) -> None:
        _make_plain(self, "tool", "status")

    @property
    def usable(self) -> bool:
        """Whether the source calls the pose good and there is one."""
        return self.status == OK and self.matrix is not None


Reading = TypeVar("Reading", PointReading, ToolReading)


def flagged(readings: Sequence[Reading], status: str) -> list[Reading]:
    """Return ``readings`` with those that were usable flagged by ``status``."""
    return [replace(one, status=status) if one.usable else one for one in readings]


@dataclass(frozen=True)
class Recording:
    """All readings of a file or a live stream, in the order they came, in one coordinate frame."""

    source: str
    points: tuple[PointReading, ...] = ()
    tools: tuple[ToolReading, ...] = ()
    frame: Frame = field(default=OTS)
    notes: tuple[str, ...] = ()
    """What the reader met and a person should know, one sentence each."""
    numbered: bool = True
    """Whether the source numbers its frames; where it does not, readings are counted, and none belong to another's."""
    end: StreamEnd | None = None
    """Why there will be no more of a stream; its last note says it at length. None for a file, or a time that is up."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "notes", tuple(map(printable, self.notes)))

    def __repr__(self) -> str:
        return f"Recording({self.source}: {len(self.points)} points, {len(self.tools)} poses, in {self.frame})"

    @property
    def tool_names(self) -> tuple[str, ...]:
        """The tools, in order of their first reading."""
        return tuple(dict.fromkeys(reading.tool for reading in self.tools))

    def poses(self, tool: str) -> FloatArray:
        """Return the usable poses (P, 4, 4), tracker from ``tool``."""
        matrices = [r.matrix for r in self.tools if r.tool == tool and r.usable and r.matrix is not None]
        return np.array(matrices, dtype=np.float64).reshape(-1, 4, 4)

    def flagged(self) -> dict[str, int]:
        """Return how many readings were flagged, by reason."""
        counts: dict[str, int] = {}
        readings: Iterable[PointReading | ToolReading] = (*self.points, *self.tools)
        for reading in readings:
            if not reading.usable:
                reason = reading.status if reading.status != OK else f"{NO_POSITION} within a kilometre"
                counts[reason] = counts.get(reason, 0) + 1
        return counts


def system_of(tool: str) -> str:
    """Return the system in which the poses of ``tool`` are told by its name, ``XToY``; empty where it names none."""
    return tool.rpartition("To")[2] if re.fullmatch("[A-Z].*To[A-Z].*", tool) else ""


def require_one_system(tools: Iterable[str], source: str) -> None:
    """Raise `FrameMismatchError` where names of ``tools`` say, as ``XToY``, that their poses are of several systems.

    One whose name tells no system counts as in that of the others.
    """
    systems = {system_of(name) for name in tools} - {""}
    if len(systems) > 1:
        raise FrameMismatchError(
            f"{source} holds poses in the coordinates of {', '.join(sorted(systems))}; expected one of them, so have "
            "all tools sent in the tracker's"
        )


def _make_plain(reading: PointReading | ToolReading, *names: str) -> None:
    """Escape what no line of text can show (names come from files and the network, and go to terminals); fill a gap."""
    if not reading.status.strip():
        object.__setattr__(reading, "status", NO_STATUS)
    for name in names:
        text: str = getattr(reading, name)
        if not text.isprintable():
            object.__setattr__(reading, name, printable(text, len(text)))


def _near(values: FloatArray) -> bool:
    return bool((np.abs(values) < FARTHEST_MM).all())


def _is_filled_in(matrix: FloatArray) -> bool:
    """Whether a (4, 4) is what programs fill in for a tool that is not seen: no measured pose is the identity."""
    return np.array_equal(matrix, np.eye(4))


def quaternion_pose(quaternion: FloatArray, translation_mm: FloatArray) -> FloatArray | None:
    """Return the (4, 4) of a scalar-first ``quaternion`` (4,) and translation (3,); None if they are no pose."""
    from scipy.spatial.transform import Rotation

    if not (_near(translation_mm) and _near(quaternion)):
        return None
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) < QUATERNION_TOLERANCE:
        return None
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    matrix[:3, 3] = translation_mm
    return None if _is_filled_in(matrix) else matrix


def tool_reading(
    frame: int, tool: str, matrix: FloatArray, time_s: float, status: str = OK
) -> tuple[ToolReading, float]:
    """Return the reading of a tracker's ``matrix`` (4, 4), mm, and by how much its rotation missed one.

    The nearest rotation is taken within `ROTATION_TOLERANCE`; what is no pose is flagged with the reason.
    """
    pose: FloatArray | None = None
    excess = 0.0
    try:
        if matrix.size != 16:
            raise InputError(f"it has {matrix.size} numbers; expected 16")
        square = matrix.reshape(4, 4)
        found = as_pose(square, tolerance=ROTATION_TOLERANCE)
        if not _near(found[:3, 3]):
            raise InputError(f"it is further away than {FARTHEST_MM:g} mm")
        if _is_filled_in(found):
            raise InputError("it is the identity, as is filled in for a tool that is not seen")
        pose = found
        excess = orthonormality_excess(square[:3, :3])
    except InputError as error:
        if status == OK:
            status = f"{NO_POSE}: {error}"
    return ToolReading(frame, tool, pose, time_s, None, status), excess


@dataclass
class Roundings:
    """Of how many poses the nearest rotation was taken, and by how much at most; a stream has too many to keep all."""

    poses: int = 0
    rounded: int = 0
    worst: float = 0.0

    def add(self, excess: float) -> None:
        """Count a pose whose rotation is off by ``excess``."""
        self.poses += 1
        self.rounded += excess > POSE_TOLERANCE
        self.worst = max(self.worst, excess)

    @property
    def notes(self) -> tuple[str, ...]:
        """Where that is more than the rounding of digits, a sentence that says so."""
        if not self.rounded:
            return ()
        return (
            f"{self.rounded} of {self.poses} poses are rotations to within {self.worst:.1g} only; "
            "the nearest rotation was taken",
        )
