"""Everything that can be told of a trajectory before it is followed, measured in the scan itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.angles import RAS_IN_LPS, AcPcAngles, ArcAngles, acpc_angles, arc_angles
from ronnaplan.planning.apart import Spacing, spacings
from ronnaplan.planning.contacts import ContactMeasures, measure_contacts
from ronnaplan.planning.crossings import Crossings, find_crossings
from ronnaplan.planning.head import SKIN_HU, Head
from ronnaplan.planning.landmarks import Landmarks
from ronnaplan.planning.lengths import TOLERANCE_MM
from ronnaplan.planning.obstacles import Clearance, Obstacle
from ronnaplan.planning.sides import side_doubt
from ronnaplan.planning.surface import Surface
from ronnaplan.planning.trajectory import Trajectory
from ronnaplan.planning.uncertainty import Expectation, PathError, path_error
from ronnaplan.text import as_read, counted, place

ENTRY_TOLERANCE_MM = 5.0
"""An entry point may lie this far outside the scalp (a click on a surface view); further out it is in air."""

DEEPEST_ENTRY_MM = 12.0
"""An entry this far beneath the scalp, along the path, may stand on the skull; a deeper one is doubted, for what is
above it is not judged: it was clicked or typed in the brain. An entry is clicked onto the scalp from as far."""

PROFILE_STEP_MM = 0.5
"""The profile along a path is sampled at least so densely."""


@dataclass(frozen=True, eq=False, repr=False)
class Measures:
    """What was measured of ``trajectory``. Values that need a surface which is not there are None.

    Depths run along the path. ``profile_mm`` (P,) and ``profile_hu`` (P,) sample it from the entry to the target.
    ``error`` is the expected one that limits count, ``planned_error`` the one as planned where a registered one counts.
    ``side_doubt`` says where the path lies on another side than its name.
    """

    trajectory: Trajectory
    crossings: Crossings
    profile_mm: FloatArray
    profile_hu: FloatArray
    clearances: tuple[Clearance, ...]
    spacings: tuple[Spacing, ...]
    arc: ArcAngles
    acpc: AcPcAngles | None
    error: PathError | None
    planned_error: PathError | None = None
    contacts: tuple[ContactMeasures, ...] = ()
    side_doubt: str | None = None

    def __repr__(self) -> str:
        doubted = f", {counted(len(self.doubts), 'doubt')}" if self.doubts else ""
        met = counted(len(self.clearances), "obstacle")
        return f"Measures({self.trajectory!r}; {met}, {counted(len(self.spacings), 'other path')}{doubted})"

    @property
    def length_mm(self) -> float:
        """Distance from entry to target."""
        return self.trajectory.length_mm

    @property
    def depth_below_scalp_mm(self) -> float | None:
        """Way from the scalp to the target."""
        return None if self.crossings.scalp is None else self.crossings.scalp.reach_mm

    @property
    def depth_below_skull_mm(self) -> float | None:
        """Way from the outer table to the target."""
        return None if self.crossings.outer is None else self.crossings.outer.reach_mm

    @property
    def entry_below_scalp_mm(self) -> float | None:
        """How far the planned entry lies inside the scalp (negative: outside)."""
        return entry_below_scalp_mm(self.trajectory, self.crossings)

    @property
    def skull_thickness_mm(self) -> float | None:
        """Bone along the path, from the outer to the inner table."""
        outer, inner = self.crossings.outer, self.crossings.inner
        return None if outer is None or inner is None else outer.reach_mm - inner.reach_mm

    @property
    def skull_angle_deg(self) -> float | None:
        """Angle between the path and the normal of the outer table."""
        return _angle_deg(self.crossings.outer, self.trajectory.inward)

    @property
    def scalp_angle_deg(self) -> float | None:
        """Angle between the path and the normal of the scalp."""
        return _angle_deg(self.crossings.scalp, self.trajectory.inward)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons to doubt the measures, one sentence each."""
        surfaces = {"scalp": self.crossings.scalp, "outer table": self.crossings.outer}
        surfaces["inner table"] = self.crossings.inner
        unclear = [
            f"the {name} is not clear here (thick slices, rough or thin bone); its place is that of a threshold"
            for name, surface in surfaces.items()
            if surface is not None and not surface.clear
        ]
        ends = (entry_doubt(self.trajectory, self.crossings), self.side_doubt)
        return (*(one for one in ends if one is not None), *unclear, *self._contact_doubts())

    @property
    def named_spacings(self) -> Iterator[tuple[str, Spacing]]:
        """Other trajectories by what they are called among all that is kept away from: a marker may have that name."""
        taken = {as_read(one.name) for one in self.clearances}
        for beside in self.spacings:
            yield f"trajectory {beside.other}" if as_read(beside.other) in taken else beside.other, beside

    def _contact_doubts(self) -> Iterator[str]:
        electrode, instrument = self.trajectory.electrode, self.trajectory.instrument
        if electrode is not None and electrode.diameter_mm > instrument.diameter_mm:
            yield (
                f"the electrode is {electrode.diameter_mm:g} mm thick but the path is judged for an instrument of "
                f"{instrument.diameter_mm:g} mm"
            )
        outside = [str(one.number) for one in self.contacts if one.inside is False]
        if outside:
            yield f"contacts that do not lie within the inner table: {', '.join(outside)}"


def measure(
    trajectory: Trajectory,
    head: Head,
    *,
    obstacles: Sequence[Obstacle] = (),
    others: Sequence[Trajectory] = (),
    landmarks: Landmarks | None = None,
    expected: Expectation = Expectation(),  # noqa: B008  # frozen
    tolerance_mm: float = TOLERANCE_MM,
    frame_axes: FloatArray = RAS_IN_LPS,
    rough: bool = False,
) -> Measures:
    """Measure ``trajectory`` in ``head``.

    ``others`` are the plan's trajectories (itself is left out by name); ``expected`` is what error is to be
    expected of the registration; rows of ``frame_axes`` (3, 3) are right, anterior, superior of the stereotactic frame
    in LPS (default: square to the scanner). The chance that is told is that of staying within ``tolerance_mm``.
    ``rough``: distances to labels are to their voxels only, as while an end is dragged; contacts are not judged then.
    Raises `FrameMismatchError` for another frame and `InputError` for ends outside the scan or in air.
    """
    check_type(trajectory, Trajectory, "the trajectory", "a plan holds some")
    check_type(head, Head, "the head", "Head.of(volume) returns one")
    crossings = check_ends(trajectory, head)
    start = trajectory.entry_mm
    depth = np.linspace(0.0, trajectory.length_mm, int(np.ceil(trajectory.length_mm / PROFILE_STEP_MM)) + 1)
    clearances = [obstacle.clearance(trajectory, rough=rough) for obstacle in obstacles]
    return Measures(
        trajectory,
        crossings,
        depth,
        head.scan.values_hu(trajectory.at_depth(depth)),
        tuple(one for one in clearances if one is not None),
        spacings(trajectory, others),
        arc_angles(start, trajectory.target_mm, frame_axes),
        acpc_angles(landmarks, start, trajectory.target_mm) if landmarks else None,
        path_error(trajectory, expected.counted, tolerance_mm) if expected.counted else None,
        path_error(trajectory, expected.beside, tolerance_mm) if expected.beside else None,
        measure_contacts(trajectory, obstacles, crossings.inner, rough=rough),
        side_doubt(trajectory, head, landmarks),
    )


def check_ends(trajectory: Trajectory, head: Head) -> Crossings:
    """Return what lies along the path; raises `InputError` for ends outside the scan or in air."""
    head.volume.frame.require(trajectory.frame)
    values = head.scan.values_hu(np.stack([trajectory.entry_mm, trajectory.target_mm]))
    for end, end_mm, value in zip(
        ("entry", "target"), (trajectory.entry_mm, trajectory.target_mm), values, strict=True
    ):
        if np.isnan(value):
            raise InputError(
                f"the {end} of {trajectory.name} at LPS {place(end_mm)} lies outside the scan; check the coordinates "
                "(LPS or RAS?)"
            )
    if values[1] < SKIN_HU:
        raise InputError(
            f"the target of {trajectory.name} at LPS {place(trajectory.target_mm)} lies in air ({values[1]:.0f} HU); "
            "choose a place in the head"
        )
    crossings = find_crossings(head, trajectory.target_mm, -trajectory.inward)
    if crossings.scalp is not None:
        outside = trajectory.length_mm - crossings.scalp.reach_mm
        if outside > ENTRY_TOLERANCE_MM:
            raise InputError(
                f"the entry of {trajectory.name} at LPS {place(trajectory.entry_mm)} lies in air, {outside:.1f} mm "
                "outside the scalp; choose a place on the scalp"
            )
    elif values[0] < SKIN_HU:
        raise InputError(
            f"the entry of {trajectory.name} at LPS {place(trajectory.entry_mm)} lies in air; "
            "choose a place on the scalp"
        )
    return crossings


def entry_below_scalp_mm(trajectory: Trajectory, crossings: Crossings) -> float | None:
    """Return how far the entry lies inside the scalp, along the path; None where the path meets no scalp."""
    return None if crossings.scalp is None else crossings.scalp.reach_mm - trajectory.length_mm


def entry_doubt(trajectory: Trajectory, crossings: Crossings) -> str | None:
    """Return what is wrong with an entry deeper than `DEEPEST_ENTRY_MM` beneath the scalp; None for another."""
    below_mm = entry_below_scalp_mm(trajectory, crossings)
    if below_mm is None or below_mm <= DEEPEST_ENTRY_MM:
        return None
    return (
        f"the entry lies {below_mm:.0f} mm beneath the scalp, and the way through there is not judged; "
        "move it onto the scalp"
    )


def end_doubts(
    trajectory: Trajectory, crossings: Crossings, head: Head, landmarks: Landmarks | None
) -> tuple[str, ...]:
    """Return what makes the ends doubtful, a sentence each, after the trajectory's name."""
    doubts = entry_doubt(trajectory, crossings), side_doubt(trajectory, head, landmarks)
    return tuple(f"{trajectory.name}: {doubt}" for doubt in doubts if doubt is not None)


def _angle_deg(surface: Surface | None, inward: FloatArray) -> float | None:
    if surface is None or not surface.clear:
        return None
    across = float(np.linalg.norm(np.cross(surface.normal, inward)))
    return float(np.degrees(np.arctan2(across, abs(float(surface.normal @ inward)))))
