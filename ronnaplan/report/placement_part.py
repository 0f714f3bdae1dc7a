"""The report's placement of the robot: where its base shall stand, how it serves each task, in which order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ronnaplan.case.folder import Case
from ronnaplan.case.placed import placement_doubts
from ronnaplan.documents.placement import PlaceEntry, PlacementDocument
from ronnaplan.planning.rows import number
from ronnaplan.report.html import Part, element, picture, table

if TYPE_CHECKING:
    from ronnaplan.report.overview import View

TITLE = "Placement of the robot"
PLACES = ("", "x mm", "y mm", "z mm", "turn deg", "least joint margin deg", "serves all after parking")
TASKS = ("task", "", "joints deg", "singular deg", "clearance mm", "tracker deg")


def placement_part(case: Case, seen: View | None = None) -> Part:
    """Tell the places found, and of the best one every task's margins; what blocks is a warning.

    ``seen`` is what there is to see of the case; without it the robot is shown alone.
    """
    found = case.placement
    if found is None:
        return Part(TITLE)
    doubts = placement_doubts(found, case.plan or (), case.fiducials)
    if not found.robot_from_ct:
        return Part(TITLE, [], doubts)
    best = found.robot_from_ct[0]
    shown = [(_name(found, n), one) for n, one in enumerate(found.robot_from_ct, 1)]
    tasks = [
        (
            one.name,
            one.kind,
            *(number(value, 1) for value in (one.joint_margin_deg, one.singularity_deg, one.clearance_mm)),
            number(one.tracker_deg, 1),
        )
        for one in best.tasks
    ]
    body = [
        *_drawn(found, seen),
        table(PLACES, [_place(name, one) for name, one in shown]),
        *(element("p", f"{name}: {one.no_way}") for name, one in shown if one.no_way is not None),
        element("p", _rests_on(found), "note"),
        element("h3", "Margins from the first place, the least along each way"),
        table(TASKS, tasks),
        *_order(best),
    ]
    return Part(TITLE, body, doubts)


def _drawn(found: PlacementDocument, seen: View | None) -> list[str]:
    """Return a picture of the robot beside the head, where the document holds it."""
    from ronnaplan.scene import robot
    from ronnaplan.scene.vtk import Workshop

    still = b""
    if seen is not None:
        still = seen.robot_png
    elif robot.robot_things(found):
        with Workshop() as workshop:
            still = robot.still_png(workshop, found)
    caption = "the robot at the first place, in its reference posture; the ring is its reach about its shoulder"
    return [picture(still, caption)] if still else []


def _order(best: PlaceEntry) -> list[str]:
    """Return in which order the arm comes to the tasks, where it comes to any."""
    if not best.route.order:
        return []
    turned = f"joints turn by {best.route.travel_deg:.0f} degrees in all"
    return [element("p", f"order: {', '.join(best.route.order)}; {turned}")]


def _name(found: PlacementDocument, count: int) -> str:
    return "as measured" if found.status == "parked" else f"place {count}"


def _place(name: str, one: PlaceEntry) -> list[str]:
    numbers = [f"{value:.0f}" for value in one.position]
    return [name, *numbers, number(one.worst_margin_deg, 1), number(one.surely, 3)]


def _rests_on(found: PlacementDocument) -> str:
    told = f"{found.arm_text}; coordinates of the base in the room"
    if found.status == "parked":
        return told
    return (
        f"{told}; parked within {found.parking.sigma_mm:g} mm and {found.parking.sigma_deg:g} degrees (one sigma)"
    )
