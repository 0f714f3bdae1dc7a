"""The contacts of the electrode that stays along a path: where they lie, and what they come near to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planning.obstacles import Clearance, Kind, Obstacle, PostedMarker
from ronnaplan.planning.surface import Surface
from ronnaplan.planning.trajectory import Instrument, Trajectory


@dataclass(frozen=True, eq=False)
class ContactMeasures:
    """One contact, the deepest is number 1: its middle (3,) in LPS mm, and how deep that is from the entry.

    ``inside`` tells that all of it lies beyond the inner table, None where that is not known. ``clearances`` are those
    of the contact alone, as thick as the electrode, to metal and no-go regions; empty where they were not measured.
    """

    number: int
    center_mm: FloatArray
    depth_mm: float
    inside: bool | None
    clearances: tuple[Clearance, ...] = ()


def contact_ends_mm(trajectory: Trajectory) -> FloatArray:
    """Return upper and lower edge (N, 2, 3) of every contact on the path's axis, LPS mm, the deepest first."""
    reach_mm = trajectory.electrode.contact_mm / 2 if trajectory.electrode else 0.0
    ends: FloatArray = trajectory.contacts_mm[:, np.newaxis] + np.outer((-reach_mm, reach_mm), trajectory.inward)
    return ends


def contact_paths(trajectory: Trajectory) -> list[Trajectory]:
    """Return every contact as a path of its own, from its upper to its lower edge, the deepest first."""
    electrode = trajectory.electrode
    if electrode is None:
        return []
    body = Instrument(electrode.name, electrode.diameter_mm, electrode.contact_mm)
    return [
        Trajectory(f"{trajectory.name} contact {n}", upper, lower, trajectory.frame, body)
        for n, (upper, lower) in enumerate(contact_ends_mm(trajectory), start=1)
    ]


def measure_contacts(
    trajectory: Trajectory, obstacles: Sequence[Obstacle], inner: Surface | None, *, rough: bool
) -> tuple[ContactMeasures, ...]:
    """Measure the contacts as the path itself is measured; ``rough``: where they lie only.

    ``inner`` is the inner table where the path crosses it. Markers on the scalp are left to the path.
    """
    near = [] if rough else [one for one in obstacles if not isinstance(one, PostedMarker)]
    found = []
    for number, one in enumerate(contact_paths(trajectory), start=1):
        center = (one.entry_mm + one.target_mm) / 2
        depth = float((center - trajectory.entry_mm) @ trajectory.inward)
        upper = trajectory.length_mm - depth + one.length_mm / 2  # of its upper edge, from the target
        found.append(
            ContactMeasures(
                number,
                center,
                depth,
                None if inner is None else bool(upper <= inner.reach_mm),
                tuple(
                    clearance
                    for clearance in (obstacle.clearance(one) for obstacle in near)
                    if clearance is not None
                ),
            )
        )
    return tuple(found)


def nearest_contacts(contacts: Sequence[ContactMeasures]) -> dict[tuple[Kind, str], tuple[int, Clearance]]:
    """Return for each obstacle the number of the contact that may come nearest to it, and how near it comes."""
    found: dict[tuple[Kind, str], tuple[int, Clearance]] = {}
    for contact in contacts:
        for one in contact.clearances:
            key = one.kind, one.name
            if key not in found or one.at_least_mm < found[key][1].at_least_mm:
                found[key] = contact.number, one
    return found
