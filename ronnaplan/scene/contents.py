"""What there is to see of a whole case."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.case.folder import Case
from ronnaplan.case.surroundings import Labels
from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.errors import InputError
from ronnaplan.planning import Plan, Trajectory
from ronnaplan.scene import things
from ronnaplan.scene.alone import alone
from ronnaplan.scene.field import Field, bounds_mm, of_mask
from ronnaplan.scene.robot import robot_things
from ronnaplan.scene.shapes import Body
from ronnaplan.scene.surfaces import MOST_TRIANGLES, REGION, surfaces
from ronnaplan.scene.things import Thing
from ronnaplan.scene.vtk import Workshop

OPACITY = {"skull": 0.3, "skin": 0.2}
"""So that trajectories are seen through the head."""


def things_of(
    workshop: Workshop,
    case: Case,
    most_triangles: int = MOST_TRIANGLES,
    *,
    labels: Labels | None = None,
    robot: bool = False,
    spreads: bool = False,
) -> list[Thing]:
    """Return markers, rejected candidates, trajectories and regions of a case, its skull and its skin last.

    ``labels`` are regions that are shown beside those to keep away from. With ``robot`` also the robot at its place,
    which is much larger than a head; with ``spreads`` the ellipsoids in which the markers' centers lie with a chance
    of 95 %, enlarged as their names say. Skin, skull and each region have at most so many triangles.

    Raises `InputError` where there is nothing to show, and where pyvista is not installed.
    """
    shown = [] if case.fiducials is None else _markers(case.fiducials, spreads)
    if robot and case.placement is not None:
        shown += robot_things(case.placement)
    plan = case.plan
    if plan is not None:
        for path in plan if case.volume is None else beside(plan, case.volume):
            judged = case.surroundings.judge(path, plan).measures if case.volume is not None else None
            shown += things.path(path, judged)
    if case.volume is not None:
        for name, mask in case.no_go.items():
            shown.append(things.no_go(name, _region(workshop, case.volume, mask, most_triangles)))
        for number, (name, mask) in enumerate((labels or {}).items()):
            region = _region(workshop, case.volume, mask, most_triangles)
            shown.append(things.label_map(name, region, things.label_colour(number)))
        shown += head_things(workshop, case.volume, most_triangles)
    whole = [one for one in shown if len(one.body.triangles)]
    if not whole:
        raise InputError("the case holds nothing to show; give its scan with --ct")
    return whole


def head_things(workshop: Workshop, volume: CTVolume, most_triangles: int) -> list[Thing]:
    """Return skull and skin, each of at most so many triangles, through which trajectories are seen."""
    head = surfaces(workshop, alone(Field.of(volume)), most_triangles=most_triangles)
    return [things.skull(head["skull"], OPACITY["skull"]), things.skin(head["skin"], OPACITY["skin"])]


def _markers(document: FiducialsDocument, spreads: bool) -> list[Thing]:
    found = document.fiducials
    shown = [things.marker(one.label, np.array(one.center), one.diameter_mm) for one in found]
    if spreads and found:
        covariances = np.array([one.covariance for one in found])
        factor = things.spread_factor(covariances, document.marker.diameter_mm)
        shown += [
            things.spread(one.label, np.array(one.center), np.array(one.covariance), factor) for one in found
        ]
    if document.rejected:
        shown.append(things.rejected([np.array(one.center) for one in document.rejected]))
    return shown


def _region(workshop: Workshop, volume: CTVolume, mask: NDArray[np.bool_], most_triangles: int) -> Body:
    """Return the surface of a region (K, J, I)."""
    field = of_mask(volume, mask)
    return surfaces(workshop, field, {"region": REGION}, outside=0.0, most_triangles=most_triangles)["region"]


def beside(plan: Plan, volume: CTVolume) -> list[Trajectory]:
    """Return the trajectories that lie in the scan or near it: among others nothing would be seen of the head."""
    low, high = bounds_mm(volume)
    reach = high - low
    return [
        one
        for one in plan
        if all(((end > low - reach) & (end < high + reach)).all() for end in (one.entry_mm, one.target_mm))
    ]
