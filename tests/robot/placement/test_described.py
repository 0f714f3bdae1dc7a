"""What an arm's description may mean otherwise, told before a base is sought for it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ronnaplan.documents.room_example import example_room
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.arm.urdf import UrdfArm, read_urdf
from ronnaplan.robot.placement.described import doubts_of_arm, doubts_of_description, length_mm
from ronnaplan.robot.placement.room import Capsule
from tests.robot.arm.arms import KR6
from tests.robot.placement.cases import room


def described(text: str, folder: Path) -> UrdfArm:
    (folder / "arm.urdf").write_text(text)
    return read_urdf(folder / "arm.urdf")


@pytest.mark.parametrize(
    ("times", "told"),
    [
        (1.0, None),
        (1 / 0.0254, "from its first joint to its flange the arm kr6 is 40 m long"),
        (0.0254, "from its first joint to its flange the arm kr6 is 0.0258 m long"),
    ],
)
def test_an_arm_that_is_too_long_or_too_short_to_be_described_in_metres_is_told(
    tmp_path: Path, times: float, told: str | None
) -> None:
    def longer(place: re.Match[str]) -> str:
        return '<origin xyz="' + " ".join(str(times * float(number)) for number in place[1].split()) + '"'

    arm = described(re.sub('<origin xyz="([^"]*)"', longer, KR6), tmp_path).arm
    assert length_mm(arm) == pytest.approx(times * length_mm(described(KR6, tmp_path).arm))
    assert [doubt.split(";")[0] for doubt in doubts_of_arm(arm, example_room())] == (
        [] if told is None else [told]
    )


def test_nothing_is_doubtful_of_the_built_in_arm() -> None:
    assert doubts_of_arm(kr6_r900(), example_room()) == ()


def test_links_that_a_room_states_no_bodies_of_are_told() -> None:
    """Its bodies take the place of all shapes: a link that was forgotten would be taken to meet nothing."""
    clad = tuple((link, Capsule("one", (0.0, 0.0, 0.0), (0.0, 0.0, 100.0), 50.0)) for link in (0, 1, 2, 5))
    (told,) = doubts_of_arm(kr6_r900(), room(arm_bodies=clad))
    assert "there are none of link 3, 4: collisions of these are not looked at" in told


def test_a_controllers_base_is_told_unless_a_link_is_named_as_the_base(tmp_path: Path) -> None:
    """As of UR's, whose controllers count from a link that is turned by half a turn against the description's root."""
    base = '<joint name="b" type="fixed"><origin rpy="0 0 3.14"/><parent link="root"/><child link="base"/></joint>'
    arm = KR6.replace('link="base"', 'link="root"').replace('<link name="base">', '<link name="root">')
    read = described(arm.replace("</robot>", f'<link name="base"/>{base}</robot>'), tmp_path)
    of_base = "R is the root link of the arm's description, and its link base stands elsewhere"
    unnamed, named = (
        doubts_of_description(read, example_room(), tip_is_named=False, base_is_named=is_named)
        for is_named in (False, True)
    )
    assert [doubt for doubt in unnamed if doubt not in named] == [unnamed[0]]
    assert unnamed[0].startswith(of_base)
