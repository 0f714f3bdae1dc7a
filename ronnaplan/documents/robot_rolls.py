"""The rolls of trajectories that are exported, from the placement by which the arm serves them."""

from __future__ import annotations

import numpy as np

from ronnaplan.documents.chain import ChainDocument
from ronnaplan.documents.fields import Vector
from ronnaplan.documents.placement import PlacementDocument
from ronnaplan.documents.poses import SAME_POSE_MM
from ronnaplan.errors import InputError
from ronnaplan.planning import Plan
from ronnaplan.text import listed


def placed_x_axes(placement: PlacementDocument, plan: Plan, chain: ChainDocument) -> tuple[Vector, ...]:
    """Return where the tool's x axis points in R along each trajectory of ``plan``, as ``placement`` serves it.

    Raises `FrameMismatchError` for a placement of another scan, and `InputError` where its base is not the one that
    ``chain`` measured, where it does not serve a trajectory as it is now, and where it tells no such axes.
    """
    plan.identity.require(placement.identity)
    if placement.status != "parked":
        raise InputError(
            f"the placement is {placement.status}; expected one from where the robot was parked: check this chain with "
            "'robot place --chain', and take what that writes"
        )
    place = placement.robot_from_ct[0]
    apart = np.abs(np.array(place.r_from_ct) - chain.pose.matrix)
    if apart.max() > SAME_POSE_MM:
        raise InputError(
            f"the placement has the scan elsewhere in R than the chain (its pose differs by up to {apart.max():.2g}); "
            "check this chain with 'robot place --chain', and take what that writes"
        )
    if names := placement.not_known(plan.trajectories):
        raise InputError(f"the placement does not serve {listed(names)} as planned now; run 'robot place' again")
    if place.route.stuck:
        raise InputError(
            f"the placement has no free way to {listed(place.route.stuck)}; export by one that has a way to all"
        )
    served = {one.name: one.x_axis for one in place.tasks if one.kind == "trajectory"}
    x_axes = tuple(axis for one in plan.trajectories if (axis := served.get(one.name)) is not None)
    if len(x_axes) < len(plan.trajectories):
        raise InputError(
            "the placement does not tell where the tool's x axis points; state x_axis in [tool] of the room, and run "
            "'robot place' again"
        )
    return x_axes
