"""A placement of the robot, for the tests of all that show one."""

from __future__ import annotations

import numpy as np

from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.placement import PlacementDocument
from ronnaplan.documents.placement_made import placement_document
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.placement import Place, Placement
from ronnaplan.robot.placement.room import base_pose
from ronnaplan.robot.placement.route import Route
from ronnaplan.robot.placement.serving import Served
from tests import cases
from tests.robot.placement.cases import room

BASE = np.array([-700.0, -300.0, 900.0, 30.0])
STRETCHED = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
NEAR = ("cameras comes within 0 mm of forearm between F6 and F2: the two are only kept from overlapping",)


def placed(**changes: object) -> PlacementDocument:
    """Return a document of two places for a trajectory of the scan of `cases`, to which only one has a free way."""
    room_from_ct = np.array([[0.0, 0, -1, 10], [-1, 0, 0, 20], [0, 1, 0, 1050], [0, 0, 0, 1]])
    served = Served("left", "trajectory", np.zeros((2, 6)), 20.0, 30.0, 40.0, np.inf)
    routes = Route((), 0.0, (), ("left",), STRETCHED, ()), Route(("left",), 90.0, (), (), STRETCHED, ())
    places = tuple(
        Place(base_pose(BASE + shift), (served,), route, sure, NEAR, None)
        for shift, sure, route in zip((0.0, [300.0, 0, 0, 0]), (0.9, 0.8), routes, strict=True)
    )
    source = Source(**cases.fiducials().source.model_dump())
    found = placement_document(Placement(room_from_ct, places, ()), room(), kr6_r900(), source, cases.plan())
    return found.model_copy(update=changes)
