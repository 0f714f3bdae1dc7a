"""Tools that a tracker sees, as they move: their poses in the scan, and how far a tip is from the target."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.case.edits import OpenCase
from ronnaplan.errors import RonnaplanError, UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.storage import PIVOT, Storage
from ronnaplan.planning import Trajectory
from ronnaplan.text import isolated
from ronnaplan.tracking.recording import Recording, require_one_system
from ronnaplan.transforms import invert

if TYPE_CHECKING:
    from ronnaplan.documents.registration import RegistrationDocument
    from ronnaplan.documents.tool import PivotDocument

MOMENT_S = 0.1
"""What a tracker sends in this time is shown at once, the last of it."""

HIDDEN_S = 0.5
"""A tool that was not seen for so long is shown no longer: it may be anywhere."""

LONGEST_S = 8 * 3600.0

Moments = Iterable[Recording]


@dataclass(frozen=True, eq=False)
class SeenTool:
    """A tool in the scan: ``tip_mm`` (3,) and the unit vector ``back`` (3,) along its frame's z axis, LPS.

    ``back`` points from the tip to the side on which the frame's origin is. Without a pivot calibration the tip is the
    origin of the tool's own frame, and ``calibrated`` is False.
    """

    name: str
    tip_mm: FloatArray
    back: FloatArray
    calibrated: bool


class Following:
    """Follows the tools of one tracker in an open case, in a thread; ``notify`` is called in it after each change."""

    def __init__(self, case: OpenCase, storage: Storage) -> None:
        self.case, self.storage = case, storage
        self.notify: Callable[[], None] = lambda: None
        self.seen: tuple[SeenTool, ...] = ()
        self.ended: RonnaplanError | None = None
        """Why no tool is followed any more, until it is told."""
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._changing = threading.Lock()
        """Held while what is followed, or seen, is changed: a stream may end just as another one is begun."""

    @property
    def active(self) -> bool:
        """Whether tools are being followed."""
        return self._thread is not None

    def start(self, moments: Callable[[], Moments]) -> None:
        """Show every tool that ``moments`` tell of, in the tracker's frame, until `stop` or their end.

        Raises `UsageError` without a registration that says where the tracker's frame is, `FrameMismatchError` for one
        of readings in another frame, `InputError` for a damaged ``pivot.json``.
        """
        from ronnaplan.documents.tool import read_pivot

        self._required()
        file = self.storage.plan.with_name(PIVOT)
        tip = read_pivot(file) if file.is_file() else None
        self.stop()
        with self._changing:
            self._stopping = threading.Event()
            self._thread = threading.Thread(target=self._follow, args=(moments, tip, self._stopping), daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Follow no longer."""
        with self._changing:
            self._stopping.set()
            self._thread, self.seen = None, ()

    @property
    def ct_from_ots(self) -> FloatArray | None:
        """Where the tracker's frame lies in the scan (4, 4), None unless a registration of its markers says so."""
        return self._placed_by(self.case.registration)

    def _placed_by(self, found: RegistrationDocument | None) -> FloatArray | None:
        if found is None or found.ots_from_ct is None or self.case.outdated:
            return None
        return invert(np.array(found.ots_from_ct))

    def _required(self) -> FloatArray:
        found = self.case.registration  # which a page may take away meanwhile
        pose = self._placed_by(found)
        if found is None or pose is None:
            raise UsageError("tools are shown in the scan once its markers are registered with the tracker")
        found.require_tracker()
        return pose

    def _follow(
        self, moments: Callable[[], Moments], tip: PivotDocument | None, stopping: threading.Event
    ) -> None:
        notes: tuple[str, ...] = ()
        last: dict[str, tuple[float, SeenTool]] = {}
        ended: RonnaplanError
        try:
            for moment in moments():
                notes = moment.notes
                now = time.monotonic()
                last |= {one.name: (now, one) for one in seen_tools(moment, self._required(), tip)}
                require_one_system(last, moment.source)
                with self._changing:
                    if stopping.is_set():
                        return
                    self.seen = tuple(one for at, one in last.values() if now - at <= HIDDEN_S)
                self.notify()
            ended = UsageError("; ".join(notes) or "the tracker sends no more")
        except RonnaplanError as error:
            ended = error
        with self._changing:
            if stopping.is_set():
                return
            stopping.set()
            self._thread, self.seen, self.ended = None, (), ended
        self.notify()


def seen_tools(moment: Recording, ct_from_ots: FloatArray, tip: PivotDocument | None) -> tuple[SeenTool, ...]:
    """Return where each tool was seen last, mapped by ``ct_from_ots`` (4, 4); one that was not seen is left out.

    ``tip`` is that of the tool it names, and of no other.
    """
    found = []
    for name in moment.tool_names:
        poses = moment.poses(name)
        if not len(poses):
            continue
        known = tip is not None and tip.tool == name
        pose = ct_from_ots @ poses[-1]
        at = tip.tip_mm if tip is not None and known else np.zeros(3)
        back = -pose[:3, 2] if at[2] > 0 else pose[:3, 2].copy()
        found.append(SeenTool(name, pose[:3, :3] @ at + pose[:3, 3], back, known))
    return tuple(found)


def told(one: SeenTool, path: Trajectory | None) -> str:
    """Return where a tip is, and beside the selected trajectory how far from its target and how far beside it."""
    x, y, z = one.tip_mm
    end = "tip" if one.calibrated else f"origin of its frame (no {PIVOT} of it)"
    line = f"{isolated(one.name)}: {end} at {x:.1f}, {y:.1f}, {z:.1f}"
    if path is None:
        return line
    from_target = one.tip_mm - path.target_mm
    beside = np.linalg.norm(from_target - (from_target @ path.inward) * path.inward)
    angle = np.degrees(np.arccos(np.clip(abs(one.back @ path.inward), 0.0, 1.0)))
    return (
        f"{line}; {np.linalg.norm(from_target):.1f} mm from the target of {isolated(path.name)}, "
        f"{beside:.1f} mm beside its line, z axis of its frame {angle:.1f} deg to that"
    )
