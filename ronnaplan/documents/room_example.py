"""A room to begin with."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.documents.room import RoomDocument
from ronnaplan.robot.arm.wrist import reach_mm, wrist_of
from ronnaplan.robot.placement.reference import proposed_deg
from ronnaplan.robot.placement.room import Capsule, Room
from ronnaplan.untrusted import checked

if TYPE_CHECKING:
    from ronnaplan.robot.arm.arm import SerialArm

SHORT_MM = 1.0
"""A last link that ends nearer to its joint is a mere flange, of which no shape is asked."""
USUAL_RADIUS = 0.05
"""Of links that nobody has measured, as a part of the arm's reach, while a posture is sought in which none meet."""

EXAMPLE = """\
# What stands about the patient, for `ronnaplan robot place --scene room.toml`.
# Millimetres; z points up and is 0 on the floor; x and y are yours to choose. Boxes stand upright.

format = "ronnaplan.room"
version = 1
unit = "mm"
reference_deg = [0, -120, 120, 0, 60, 0]    # the posture between tasks; joint 1 counts from where the tasks lie

[head]                          # a patient on the back, the crown towards -x
center = [0, 0, 1050]           # the middle of the head
anterior = [0, 0, 1]            # where the nose points
superior = [-1, 0, 0]           # where the crown points

[base]                          # where the robot's foot may stand
x = [-1100, 700]
y = [-1100, 1100]
z = [800, 1000]                 # on its trolley, which can be raised; z = 860 where it cannot
turn_deg = [-180, 180]          # of its forward direction about z, from x
[[base.trolley]]                # what stands under it, in its own frame
name = "trolley"
center = [0, 0, -400]
size = [500, 500, 800]

[tracker]                       # with --registration it stands where it was registered
position = [-970, 1340, 1010]
nearest_mm = 950
farthest_mm = 2400
body_mm = 250                   # the last of a line of sight is the tracker itself
beam_mm = 30                    # free radius about a line of sight

[tool]                          # on the flange, whose z points out of it
start = [0, 0, 120]             # where the instrument leaves its holder; its usable length counts from here
direction = [0, 0, 1]
standoff_mm = 30                # it begins so far before the entry
# x_axis = [1, 0, 0]            # what the robot's controller calls x of the tool, for `robot export --placement`
[[tool.body]]
name = "holder"
start = [0, 0, 20]
end = [0, 0, 95]
radius = 25
[[tool.body]]
name = "cameras"
start = [0, -70, 20]
end = [0, 70, 20]
radius = 35
[tool.marker]                   # what the tracker sees; leave out where nothing is tracked
at = [0, 110, 10]               # where tool and wrist do not hide it
normal = [0, 1, -1]
seen_deg = 75                   # how obliquely it is still seen

# Of a --arm whose links are meshes; these take the place of all shapes that it has.
# [[arm_body]]
# link = 2                        # 0 is the foot, 6 or 7 the last; links on joints that are held count, too
# name = "upper arm"
# start = [0, 0, 0]               # in the link's frame
# end = [455, 0, 0]
# radius = 95

[camera]                        # the stereo cameras' center point
tcp = [0, 0, 280]
direction = [0, 0, 1]
tilt_deg = 30                   # a marker may be viewed so far from straight on
standoff_mm = 50

[[box]]
name = "table"
center = [900, 0, 900]
size = [1700, 500, 120]
turn_deg = 0
[[box]]
name = "patient"
center = [850, 0, 1030]
size = [1400, 450, 220]
[[capsule]]
name = "head holder"
start = [60, -90, 960]
end = [60, 90, 960]
radius = 20

[margins]                       # less than this is not served
joint_deg = 5
singularity_deg = 8
clearance_mm = 20
tracker_deg = 5

[parking]                       # one standard deviation of where the robot comes to stand
sigma_mm = 20
sigma_deg = 3
"""
"""What ``robot place --example`` writes."""
REFERENCE = EXAMPLE[EXAMPLE.index("reference_deg") : EXAMPLE.index("\n\n[head]")]
ARM_BODY = EXAMPLE[EXAMPLE.index("# Of a --arm") : EXAMPLE.index("[camera]")]


def example_of(arm: SerialArm, turning: SerialArm, *, are_meshes: bool) -> str:
    """Return `EXAMPLE` for another arm, as described and as it is ``turning``, with some joints held.

    It has a posture that is proposed for that arm. Of links that ``are_meshes`` there is a capsule each, from
    joint to joint, whose radius is left to be measured: a room is no room with it.
    """
    room = example_room()
    if are_meshes:
        radius_mm = USUAL_RADIUS * reach_mm(wrist_of(turning))
        room = replace(room, arm_bodies=tuple(_from_joint_to_joint(arm, radius_mm)))
    angles = [f"{angle:g}" for angle in proposed_deg(turning, room)]
    posture = (
        "# The posture between tasks; joint 1 counts from where the tasks lie. This is a proposal, in which the arm is "
        f"bent:\n# state another where it is not free, of {', '.join(turning.joints)}.\n"
        f"reference_deg = [{', '.join(angles)}]"
    )
    bodies = _told_from_joint_to_joint(room) if are_meshes else ""
    return EXAMPLE.replace(REFERENCE, posture).replace(ARM_BODY, bodies)


def _from_joint_to_joint(arm: SerialArm, radius_mm: float) -> Iterator[tuple[int, Capsule]]:
    """Yield each link's number, and a capsule about the line from its joint to the next."""
    names = pairwise(["foot", *arm.joints, "flange"])
    for n, (end, (one, other)) in enumerate(zip([*arm.origins, arm.flange], names, strict=True)):
        if n < len(arm) or np.linalg.norm(end[:3, 3]) > SHORT_MM:
            x, y, z = (end[:3, 3].round(1) + 0.0).tolist()
            yield n, Capsule(f"{one} to {other}", (0.0, 0.0, 0.0), (x, y, z), radius_mm)


def _told_from_joint_to_joint(room: Room) -> str:
    entries = [
        f"[[arm_body]]\nlink = {n}\nname = {json.dumps(one.name, ensure_ascii=False)}\nstart = [0, 0, 0]\n"
        f"end = {list(one.end_mm)}\nradius = 0                      # measure it\n"
        for n, one in room.arm_bodies
    ]
    return (
        "# The arm's links, whose shapes are meshes, in their frames: from joint to joint. Move both ends to where\n"
        f"# each link is, and measure its radius; more capsules draw it more closely.\n{''.join(entries)}\n"
    )


def example_room() -> Room:
    """Return the room of `EXAMPLE`."""
    return checked(tomllib.loads(EXAMPLE), RoomDocument).room
