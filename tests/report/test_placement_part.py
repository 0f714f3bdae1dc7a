"""What the report says of the robot's place: its margins, and what nothing says that it serves."""

from __future__ import annotations

import base64
from dataclasses import replace

import pytest

from ronnaplan.case.folder import Case
from ronnaplan.case.placed import placement_doubts
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.placement import HeldEntry, MarkerEntry, PlacementDocument, placement_text
from ronnaplan.planning import Plan
from ronnaplan.report.html import html_of
from ronnaplan.report.overview import View
from ronnaplan.report.placement_part import placement_part
from ronnaplan.scene.vtk import NoGraphicsError
from tests import cases
from tests.documents.placements import NEAR, placed

UNDRAWN = View([], b"", b"")
"""Of a report of which no picture is looked at: to draw one takes two seconds."""


def test_the_report_tells_places_margins_and_what_they_do_not_cover(monkeypatch: pytest.MonkeyPatch) -> None:
    def without(*_: object) -> None:
        raise NoGraphicsError("filled in it is drawn sooner")

    monkeypatch.setattr("ronnaplan.scene.picture.rendered", without)
    plan = cases.plan()
    plan = plan.add(replace(plan.trajectory("left"), name="later"))
    part = placement_part(Case(plan=plan, placement=placed()))
    told = "".join(html_of(part.body))
    for text in ("place 2", "0.800", "least joint margin", "data:image/png"):
        assert text in told
    no_way = "no free way from the reference posture to left"
    assert f"<p>place 1: {no_way}</p>" in told
    assert part.warnings[:2] == [f"the robot has {no_way}", f"on the robot, {NEAR[0]}"]
    assert [one for one in part.warnings if "trajectory" in one] == [
        "nothing says that the robot's place serves trajectory later as it is now; run 'robot place' again"
    ]
    part = placement_part(Case(plan=plan, placement=placed()), View([], b"", b"beside the head"))
    assert base64.b64encode(b"beside the head").decode() in "".join(html_of(part.body))
    noted = placed(notes=("collisions of base are not looked at",))
    part = placement_part(Case(plan=plan, placement=noted), UNDRAWN)
    assert "the robot's place: collisions of base are not looked at" in part.warnings
    held = placed(joints=tuple("abcdef"), held=(HeldEntry(joint="g", angle_deg=12.5),))
    assert (
        "kr6r900, g held at 12.5 degrees; R is its link base, its flange the link flange; coordinates"
        in "".join(html_of(placement_part(Case(plan=plan, placement=held), UNDRAWN).body))
    )
    blocked = placed(robot_from_ct=(), status="blocked", blocked=("joint 5 is beyond its limit",))
    part = placement_part(Case(plan=cases.plan(), placement=blocked), UNDRAWN)
    assert part.warnings == ["no place of the robot serves all: joint 5 is beyond its limit"]
    assert not placement_part(Case(plan=cases.plan())).body


def test_a_place_without_a_free_way_is_not_told_to_serve_all_nor_an_order_in_which_nothing_is_reached() -> None:
    """The command told no probability of such a place; the report had it, and an order of no tasks."""
    found = placed()
    told = "".join(html_of(placement_part(Case(plan=cases.plan(), placement=found), UNDRAWN).body))
    assert "0.900" not in told
    assert "order" not in told
    assert "0.900" not in placement_text(found)
    best = placed(robot_from_ct=found.robot_from_ct[1:])
    for text in ("0.800", "order: left; joints turn by 90 degrees in all"):
        assert text in "".join(html_of(placement_part(Case(plan=cases.plan(), placement=best), UNDRAWN).body))


def test_all_faces_say_of_what_no_way_leads_in_the_same_words() -> None:
    found = placed()
    first = found.robot_from_ct[0]
    assert first.no_way == "no free way from the reference posture to left"
    met = first.model_copy(update={"at_reference": "forearm would meet base in the reference posture"})
    assert met.no_way == "no free way to any task: forearm would meet base in the reference posture"
    for place in (first, met):
        shown = placed(robot_from_ct=(place,))
        assert f"\n  {place.no_way}\n" in placement_text(shown)
        assert f"the robot has {place.no_way}" in placement_doubts(shown, (), None)
    assert found.robot_from_ct[1].no_way is None


def test_a_trajectory_that_was_changed_since_is_not_said_to_be_served() -> None:
    plan, left = cases.plan(), cases.plan().trajectory("left")
    longer = replace(left.instrument, length_mm=left.instrument.length_mm + 1.0)

    def told(given: Plan, placement: PlacementDocument) -> list[str]:
        warnings = placement_part(Case(plan=given, placement=placement), UNDRAWN).warnings
        return [one for one in warnings if "trajectory" in one]

    sentence = "nothing says that the robot's place serves trajectory left as it is now; run 'robot place' again"
    assert told(plan.edit("left", target_mm=left.target_mm * 1.001), placed()) == [sentence]
    assert told(plan.edit("left", entry_mm=left.entry_mm * 0.999), placed()) == [sentence]
    assert told(plan.edit("left", instrument=longer), placed()) == [sentence]
    assert told(plan, placed(trajectories=())) == [sentence]  # as older versions wrote it
    assert told(plan.edit("left", notes="looked at twice"), placed()) == []


def test_markers_that_were_found_anew_since_are_not_said_to_be_served() -> None:
    found = cases.fiducials()
    served = placed()
    tasks = tuple(
        served.robot_from_ct[0].tasks[0].model_copy(update={"name": one.label, "kind": "marker"})
        for one in found.fiducials
    )
    places = tuple(one.model_copy(update={"tasks": (*one.tasks, *tasks)}) for one in served.robot_from_ct)
    known = placed(robot_from_ct=places, markers=tuple(map(MarkerEntry.of, found.fiducials)))

    def told(given: FiducialsDocument, placement: PlacementDocument) -> list[str]:
        seen = Case(plan=cases.plan(), fiducials=given, placement=placement)
        warnings = placement_part(seen, UNDRAWN).warnings
        return [one for one in warnings if "marker" in one]

    first, *rest = found.fiducials
    moved = first.model_copy(update={"center": tuple(value + 0.5 for value in first.center)})
    other = found.model_copy(update={"fiducials": (moved, *rest)})
    sentence = (
        f"nothing says that the robot's place serves marker {first.label} as it is now; run 'robot place' again"
    )
    assert told(found, known) == []
    assert told(other, known) == [sentence]
    assert len(told(found, known.model_copy(update={"markers": ()}))) == len(found.fiducials)  # of older versions
    assert told(other, served) == []  # no marker was to be served
