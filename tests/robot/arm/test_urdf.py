"""Reading arms: what is read of a file, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.robot.arm import urdf
from ronnaplan.robot.arm.forward import forward
from ronnaplan.robot.arm.urdf import read_urdf
from ronnaplan.robot.arm.urdf_elements import joints_of
from tests.robot.arm.arms import IIWA_M, KR6, SEVEN, iiwa


def test_simple_shapes_become_capsules_and_meshes_are_named(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(KR6)
    read = read_urdf(tmp_path / "arm.urdf")
    assert (read.shapeless, read.arm.base_link, read.arm.flange_link) == (("base",), "base", "tool0")
    cylinder, box, ball = read.arm.bodies
    assert (cylinder.link, box.link, ball.link) == (2, 3, 5)
    np.testing.assert_allclose([cylinder.start_mm, cylinder.end_mm], [[0, 0, 0], [400, 0, 0]], atol=1e-9)
    np.testing.assert_allclose([box.start_mm, box.end_mm], [[0, -150, 0], [0, 150, 0]], atol=1e-9)
    assert box.radius_mm == pytest.approx(np.hypot(50, 100))
    assert (cylinder.radius_mm, ball.radius_mm) == (90, 60)


def test_what_hangs_on_the_arm_is_a_body_too_or_is_named(tmp_path: Path) -> None:
    ball = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
    mesh = '<collision><geometry><mesh filename="x.stl"/></geometry></collision>'
    finger = (
        f'<link name="finger">{ball}</link><joint name="grip" type="prismatic"><parent link="camera"/>'
        '<child link="finger"/><limit lower="0" upper="0.1"/></joint></robot>'
    )
    text = KR6.replace('<link name="camera"/>', f'<link name="camera">{ball}{mesh}</link>').replace(
        "</robot>", finger
    )
    text = text.replace('<link name="l4"/>', '<link name="l4"><visual/></link>')
    (tmp_path / "arm.urdf").write_text(text)
    read = read_urdf(tmp_path / "arm.urdf", tip="tool0")
    assert read.shapeless == ("base", "l4", "camera", "finger")
    camera = next(body for body in read.arm.bodies if body.name == "camera")
    place = read.arm.flange @ [0, 100, 50, 1]
    np.testing.assert_allclose([camera.start_mm, camera.end_mm], [place[:3]] * 2, atol=1e-9)
    assert camera.link == 6


def test_the_flange_is_the_link_that_was_named(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(KR6)
    arm = read_urdf(tmp_path / "arm.urdf", tip="camera").arm
    np.testing.assert_allclose(arm.tool("tool0")[:3, 3], [0, -100, -50], atol=1e-9)


@pytest.mark.parametrize(
    "joint",
    [
        'type="prismatic"><parent link="camera"/><child link="finger"/>',
        'type="revolute"><parent link="camera"/><child link="finger"/><limit lower="0" upper="1"/>',
        'type="revolute"><parent link="camera"/><child link="finger"/><mimic joint="A1"/>',
    ],
)
def test_a_gripper_on_the_flange_is_not_of_the_arm(joint: str, tmp_path: Path) -> None:
    gripper = f'<link name="finger"/><joint name="grip" {joint}</joint></robot>'
    (tmp_path / "arm.urdf").write_text(KR6.replace("</robot>", gripper))
    (tmp_path / "bare.urdf").write_text(KR6)
    arm, bare = (read_urdf(tmp_path / name).arm for name in ("arm.urdf", "bare.urdf"))
    assert arm.joints == bare.joints
    np.testing.assert_array_equal(arm.flange, bare.flange)


def test_a_flange_is_not_guessed_where_something_is_fixed_to_the_last_link(tmp_path: Path) -> None:
    """As on an iiwa, whose link 7 ends 45 mm before its flange, and on Franka's."""
    text = iiwa().replace("tool0", "link_ee")
    (tmp_path / "arm.urdf").write_text(text)
    told = r"no link is called tool0, and .* the last that turns, l7: link_ee; name .* \(`--tip LINK`\), l7 or another"
    with pytest.raises(InputError, match=told):
        read_urdf(tmp_path / "arm.urdf")
    arm = read_urdf(tmp_path / "arm.urdf", tip="link_ee").arm
    np.testing.assert_allclose(forward(arm, np.zeros(7))[:3, 3], [0.0, 0.0, 1000.0 * sum(IIWA_M)], atol=1e-9)
    hand = (
        '<link name="hand"/><joint name="bolt" type="fixed"><parent link="link_ee"/><child link="hand"/></joint>'
        '<link name="jaw"/><joint name="grip" type="prismatic"><parent link="hand"/><child link="jaw"/></joint></robot>'
    )
    (tmp_path / "arm.urdf").write_text(text.replace("</robot>", hand))
    with pytest.raises(InputError, match=r"the last that turns, l7: link_ee, hand; name"):
        read_urdf(tmp_path / "arm.urdf")


def test_of_two_fingers_it_is_told_what_holds_them(tmp_path: Path) -> None:
    """As of an xArm6 with its gripper: the link where the chains part is the flange, or near it; of two arms, both."""
    fingers = "".join(
        f'<link name="{side}"/><joint name="{side}_grip" type="revolute"><parent link="palm"/><child link="{side}"/>'
        '<limit lower="0" upper="1"/></joint>'
        for side in ("left", "right")
    )
    text = KR6.replace("tool0", "palm").replace("</robot>", f"{fingers}</robot>")
    (tmp_path / "arm.urdf").write_text(text)
    with pytest.raises(
        InputError, match=r"to left, right are equally long and part at palm; name .* \(`--tip LINK`\)"
    ):
        read_urdf(tmp_path / "arm.urdf")
    (tmp_path / "arm.urdf").write_text(text.replace("</robot>", _many_fingers(20)))
    with pytest.raises(InputError, match=r"to left, right, f0, f1, f2, f3, f4, f5 and 14 more are equally long"):
        read_urdf(tmp_path / "arm.urdf")
    unjoined = '<robot name="two"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>' + "".join(
        f'<joint name="{parent}" type="continuous"><parent link="{parent}"/><child link="{child}"/></joint>'
        for parent, child in ("ab", "cd")
    )
    (tmp_path / "arm.urdf").write_text(f"{unjoined}</robot>")
    with pytest.raises(
        InputError, match=r"the chains to b, d are equally long and hang on no link in common; name"
    ):
        read_urdf(tmp_path / "arm.urdf")


def _many_fingers(count: int) -> str:
    return (
        "".join(
            f'<link name="f{n}"/><joint name="g{n}" type="continuous"><parent link="palm"/><child link="f{n}"/></joint>'
            for n in range(count)
        )
        + "</robot>"
    )


def test_where_nothing_is_fixed_to_the_last_link_it_is_the_flange(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(SEVEN)
    arm = read_urdf(tmp_path / "arm.urdf").arm
    np.testing.assert_array_equal(arm.flange, np.eye(4))


def test_what_slides_within_the_arm_is_refused_and_what_slides_at_its_end_is_not_of_it(tmp_path: Path) -> None:
    bare = KR6.replace('name="tool0"', 'name="plate"').replace('link="tool0"', 'link="plate"')
    jaw = '<link name="jaw"/><joint name="grip" type="prismatic"><parent link="plate"/><child link="jaw"/></joint>'
    (tmp_path / "arm.urdf").write_text(bare.replace("</robot>", f"{jaw}</robot>"))
    assert len(read_urdf(tmp_path / "arm.urdf", tip="plate").arm) == 6
    with pytest.raises(
        InputError, match=r"joint grip is prismatic.*name the flange as the tip.*or call the joint fixed"
    ):
        read_urdf(tmp_path / "arm.urdf", tip="jaw")


@pytest.mark.parametrize(("kind", "how"), [("prismatic", "slide"), ("floating", "move"), ("planar", "move")])
def test_what_moves_on_the_last_link_that_turns_is_not_left_out_without_a_word(
    tmp_path: Path, kind: str, how: str
) -> None:
    """It may be a gripper's jaw, or the last joint of the arm, as of a SCARA; or it is free."""
    bare = SEVEN.replace(
        "</robot>",
        f'<link name="quill"/><joint name="stroke" type="{kind}"><parent link="l7"/><child link="quill"/>'
        '<limit lower="0" upper="0.1"/></joint></robot>',
    )
    (tmp_path / "arm.urdf").write_text(bare)
    with pytest.raises(
        InputError, match=rf"other links {how} on the last that turns, l7: quill; name .* l7 or another"
    ):
        read_urdf(tmp_path / "arm.urdf")
    assert len(read_urdf(tmp_path / "arm.urdf", tip="l7").arm) == 7


@pytest.mark.parametrize(
    ("soft", "expected"),
    [
        ('soft_lower_limit="-2.8" soft_upper_limit="2.5"', (-2.8, 2.5)),
        ('soft_lower_limit="-2.8" soft_upper_limit="9.5"', (-2.8, 2.9670597283903604)),
        ('soft_lower_limit="-2.8"', (-2.8, 0.0)),
        ("", (-2.9670597283903604, 2.9670597283903604)),
    ],
)
def test_the_limits_that_the_controller_keeps_count(
    soft: str, expected: tuple[float, float], tmp_path: Path
) -> None:
    """A robot stops at its soft limits, so that margins from the hard ones would tell too much."""
    text = KR6.replace('<limit lower="-2.96', f'<safety_controller k_velocity="10" {soft}/><limit lower="-2.96')
    (tmp_path / "arm.urdf").write_text(text)
    np.testing.assert_allclose(read_urdf(tmp_path / "arm.urdf").arm.limits_rad[0], expected)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('xyz="0 0 0.4"', 'xyz="0 0 ${height}"', "run xacro first"),
        ('name="kr6">', 'name="kr6" xmlns:x="http://ros.org/wiki/xacro"><x:kr6/>', "run xacro first"),
        ("</robot>", '<xacro:kr6 xmlns:xacro="http://www.ros.org/wiki/xacro"/></robot>', "run xacro first"),
        (
            '<limit lower="-2.9670597283903604" upper="2.9670597283903604"/>',
            '<limit effort="1"/>',
            "A1 has no limits",
        ),
        ('<child link="l5"/>', '<child link="l4"/>', "joints A4 and A5 carry one link"),
        ("</robot>", '<link name="l4"/></robot>', "two links are called 'l4'"),
        ('name="A2"', 'name="A1"', "two joints are called 'A1'; expected each name once"),
        ('name="kr6"', 'name=""', "the robot is called ''; expected a name that"),
        ('name="A2"', 'name=" "', "a joint is called ' '; expected a name that"),
        ('name="A2"', 'name="A&#9;2"', r"a joint is called 'A\\t2'; expected a name that"),
        ('name="A2"', 'name="A&#10;2"', r"a joint is called 'A\\n2'; expected a name that"),
        ('<link name="l1"/>', '<link name=""/>', "a link is called ''; expected a name that"),
        ('name="kr6">', 'name="kr6">${prefix}', "run xacro first"),
        ("<robot", "<!DOCTYPE robot [<!ENTITY a 'b'>]><robot", "declares a document type"),
        ("</robot>", "", "is no XML"),
        ("robot", "arm", "holds <arm>; expected <robot>"),
        ('name="A3" type="revolute"', 'name="A3" type="prismatic"', "joint A3 is prismatic"),
        (
            '<axis xyz="-1 0 0"/><limit lower="-3',
            '<mimic joint="A1"/><axis xyz="-1 0 0"/><limit lower="-3',
            "A4 mimics",
        ),
        (
            'upper="0.7853981633974483"',
            'upper="-9"',
            "joint A2 of kr6 has the limits .* expected the lower one first",
        ),
        ('lower="-2.9670597283903604"', 'lower="-170"', "A1 has the limits -170 .* in degrees"),
        ('lower="-2.9670597283903604"', 'lower="-1e16"', r"degrees\? A joint without limits is called continuous"),
        ('<limit lower="-2.9670597283903604" upper="2.9670597283903604"/>', "", "A1 has no limits"),
        ('xyz="0 0 0.4"', 'xyz="0 0 nan"', "no three numbers"),
        ('xyz="0 0 0.4"', 'xyz="0 0 400"', r"joint A1 has the origin '0 0 400' m; is it in mm\? Expected metres"),
        (
            'xyz="0 0 0.4"',
            'xyz="0 0 0.4" rpy="0 90 0"',
            r"joint A1 is turned by rpy '0 90 0' rad; is it in degrees",
        ),
        (
            'xyz="0 0 0.4"',
            'xyz="0 0 0.4" quat_xyzw="0 0 0 1"',
            "the origin of joint A1 has 'quat_xyzw', which is not",
        ),
        ('xyz="0 0 0.4"', 'xyz="0 0 0.4" rpy="0 pi 0"', "rpy of joint A1: '0 pi 0' are no three numbers"),
        (
            'lower="-2.9670597283903604" upper="2.9670597283903604"',
            'lower="0" upper="0"',
            "joint A1 of kr6 has the limits 0 to 0 rad; .* room between them",
        ),
        (
            "<limit",
            '<safety_controller k_velocity="1" soft_lower_limit="0" soft_upper_limit="0"/><limit',
            "joint A1 has the soft limits 0 to 0 rad, which leave nothing of -2.96706 to 2.96706; correct the",
        ),
        (
            "<limit",
            '<safety_controller soft_lower_limit="-168" soft_upper_limit="168"/><limit',
            "A1 has the soft limits -168 to 168 rad; are they in degrees",
        ),
        ("<limit", '<safety_controller soft_lower_limit="x"/><limit', "a soft limit of joint A1 is no number"),
        ('radius="0.06"', 'radius="nan"', "has the size nan m"),
        ('radius="0.06"', 'radius="-0.06"', "has the size -0.06 m"),
        ('<child link="l1"/>', "", r"is damaged \(joint A1 has no <child>"),
        ('<parent link="base"/>', "", r"joint A1 has no <parent>"),
        ('<parent link="base"/>', "<parent/>", r"the parent of joint A1 has no link"),
        ('name="A1" type="revolute"', 'name="A1"', "joint A1 has no type"),
        ('name="A1" type="revolute"', 'type="revolute"', "a joint has no name"),
        ('<link name="l1"/>', "<link/>", "a link has no name"),
        ('<axis xyz="0 0 -1"/>', "<axis/>", "the axis of joint A1 has no xyz"),
        ('<sphere radius="0.06"/>', "<sphere/>", "the sphere of link l5 has no radius"),
        (
            '<child link="camera"/>',
            '<child link="lamp"/>',
            "joint mount names the child 'lamp', but there is no such link",
        ),
        (
            '<parent link="base"/>',
            '<parent link="lamp"/>',
            "joint A1 names the parent 'lamp', but there is no such",
        ),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 1e300"/>', "'0 0 1e300' are no three numbers of up to"),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 1e-200"/>', "joint A1 has the axis '0 0 1e-200'"),
        ('xyz="0 0 0.4"', 'xyz="0 0 1e308"', "'0 0 1e308' are no three numbers of up to"),
        ('xyz="0 0 0.4"', 'xyz="0 0 1_0"', "'0 0 1_0' are no three numbers"),
        ('upper="0.7853981633974483"', 'upper="1_0"', "a limit of joint A2 is no number"),
        ('radius="0.06"', 'radius="1_0"', "has the size 1_0 m"),
        ('<parent link="base"/>', '<parent link="l6"/>', "round in a circle"),
        ("<limit", '<origin xyz="0 0 0.9"/><limit', "joint A1 has more than one <origin>; expected one"),
    ],
)
def test_what_is_no_arm_is_refused(old: str, new: str, sentence: str, tmp_path: Path) -> None:
    assert old in KR6
    (tmp_path / "arm.urdf").write_text(KR6.replace(old, new))
    with pytest.raises(InputError, match=sentence):
        read_urdf(tmp_path / "arm.urdf")


def test_a_joint_to_a_link_that_is_not_there_is_named_where_the_chain_goes_by_it(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(
        '<robot name="r"><link name="base"/><joint name="j1" type="revolute"><parent link="base"/><child link="l1"/>'
        '<limit lower="-1" upper="1"/></joint><joint name="j2" type="fixed"><parent link="l1"/>'
        '<child link="l2"/></joint><link name="l2"/></robot>'
    )
    with pytest.raises(InputError, match=r"joint j1 names the child 'l1', but there is no such link; correct"):
        read_urdf(tmp_path / "arm.urdf")


def test_text_of_a_simulators_plugin_may_be_marked_as_text(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(KR6.replace("</robot>", "<gazebo><![CDATA[a < b]]></gazebo></robot>"))
    assert len(read_urdf(tmp_path / "arm.urdf").arm) == 6


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<limit lower="-2.96', '<limit drake:acceleration="2.5" lower="-2.96'),
        ("</robot>", '<drake:group name="g"><drake:member link="l1"/></drake:group></robot>'),
        ("<robot", '<robot xmlns="http://www.ros.org"'),
        ("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"'),
    ],
)
def test_names_of_other_programs_need_not_be_declared(old: str, new: str, tmp_path: Path) -> None:
    """ROS looks up no namespaces, and published descriptions of UR3e and UR5e use ``drake:`` without a word."""
    assert old in KR6
    (tmp_path / "arm.urdf").write_text(KR6.replace(old, new))
    read = read_urdf(tmp_path / "arm.urdf")
    assert (read.arm.joints, len(read.arm.bodies)) == (("A1", "A2", "A3", "A4", "A5", "A6"), 3)


def test_a_comment_may_hold_what_xacro_would_have_replaced(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(KR6.replace("</robot>", "<!-- of ${prefix}arm -->\n</robot>"))
    assert read_urdf(tmp_path / "arm.urdf").arm.name == "kr6"


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32"])
def test_entities_are_not_hidden_by_an_encoding(encoding: str, tmp_path: Path) -> None:
    text = "<!DOCTYPE robot [<!ENTITY a 'b'>]>" + KR6.replace('name="kr6"', 'name="&a;"')
    (tmp_path / "arm.urdf").write_bytes(text.encode(encoding))
    with pytest.raises(InputError, match=r"arm\.urdf is not written in UTF-8 .* save it as UTF-8"):
        read_urdf(tmp_path / "arm.urdf")


def test_a_byte_order_mark_and_names_in_any_script_are_read(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(KR6.replace('name="kr6"', 'name="Arm für Köln"'), encoding="utf-8-sig")
    assert read_urdf(tmp_path / "arm.urdf").arm.name == "Arm für Köln"


class Followed(dict[str, Any]):
    """Joints by their links, which counts how often one is followed to the next."""

    times = 0

    def __getitem__(self, link: str) -> Any:
        Followed.times += 1
        return super().__getitem__(link)


def test_of_thousands_of_links_each_one_is_followed_a_few_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each link's chain walked anew followed a thousand times as many, for two minutes."""
    parents = ["l7", *(f"f{n}" for n in range(3999))]
    fixed = [
        f'<link name="f{n}"/><joint name="g{n}" type="fixed"><origin xyz="0.001 0 0"/><parent link="{parent}"/>'
        f'<child link="f{n}"/></joint>'
        for n, parent in enumerate(parents)
    ]
    (tmp_path / "arm.urdf").write_text(SEVEN.replace("</robot>", "".join(fixed) + "</robot>"))
    monkeypatch.setattr(urdf, "joints_of", lambda *given: Followed(joints_of(*given)))
    with pytest.raises(InputError, match=r"l7: f0, f1, f2, f3, f4, f5, f6, f7 and 3992 more; name"):
        read_urdf(tmp_path / "arm.urdf")
    arm = read_urdf(tmp_path / "arm.urdf", tip="l7").arm
    assert (len(arm), len(arm.frames)) == (7, 4001)
    assert 4000 <= Followed.times <= 16_000


def test_of_thousands_of_fingers_on_a_long_chain_each_link_is_followed_a_few_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The chain to each finger walked anew, to tell where they part, followed millions."""
    parents = ["l7", *(f"r{n}" for n in range(1999))]
    rods = "".join(
        f'<link name="r{n}"/><joint name="s{n}" type="fixed"><parent link="{parent}"/><child link="r{n}"/></joint>'
        for n, parent in enumerate(parents)
    )
    hand = _many_fingers(2000).replace("palm", "r1999")
    (tmp_path / "arm.urdf").write_text(SEVEN.replace("</robot>", rods + hand))
    monkeypatch.setattr(urdf, "joints_of", lambda *given: Followed(joints_of(*given)))
    monkeypatch.setattr(Followed, "times", 0)
    with pytest.raises(InputError, match=r"f7 and 1992 more are equally long and part at r1999; name"):
        read_urdf(tmp_path / "arm.urdf")
    assert 4000 <= Followed.times <= 24_000


def test_the_base_may_be_a_link_beside_the_arm_or_behind_what_moves_it(tmp_path: Path) -> None:
    """UR's controllers report in ``base``, half a turn from ``base_link``; a mobile robot's arm begins at its lift."""
    stand = (
        '<link name="cart"/><joint name="lift" type="prismatic"><origin xyz="0 0 0.7"/><parent link="cart"/>'
        '<child link="plate"/><axis xyz="0 0 1"/><limit lower="0" upper="1"/></joint><link name="plate">'
        '<collision><geometry><sphere radius="0.2"/></geometry></collision></link>'
        '<joint name="bolts" type="fixed"><origin xyz="0 0.1 0"/><parent link="plate"/><child link="base"/></joint>'
        '<link name="r"/><joint name="r" type="fixed"><origin xyz="0 0 0.3" rpy="0 0 3.141592653589793"/>'
        '<parent link="base"/><child link="r"/></joint></robot>'
    )
    (tmp_path / "arm.urdf").write_text(KR6.replace("</robot>", stand))
    (tmp_path / "bare.urdf").write_text(KR6)
    bare, base, turned, plate = (
        read_urdf(tmp_path / name, base=link)
        for name, link in (("bare.urdf", None), ("arm.urdf", "base"), ("arm.urdf", "r"), ("arm.urdf", "plate"))
    )
    angles = np.random.default_rng(1).uniform(-1, 1, (5, 6))
    reached = forward(bare.arm, angles)
    assert [read.base_apart for read in (bare, base, turned, plate)] == [False, False, True, True]
    np.testing.assert_allclose(forward(base.arm, angles), reached, atol=1e-9)
    half = np.diag([-1.0, -1, 1, 1])
    half[2, 3] = -300
    np.testing.assert_allclose(forward(turned.arm, angles), half @ reached, atol=1e-9)
    np.testing.assert_allclose(forward(plate.arm, angles)[:, 1, 3], reached[:, 1, 3] + 100, atol=1e-9)
    ball = next(body for body in turned.arm.bodies if body.name == "plate")
    np.testing.assert_allclose((ball.link, *ball.start_mm), [0, 0, 100, -300], atol=1e-9)
    with pytest.raises(
        InputError, match=r"joint lift is prismatic; .*, a link beyond it as the base \(`--base LINK`\)"
    ):
        read_urdf(tmp_path / "arm.urdf")
    with pytest.raises(
        InputError, match="the base 'camer' is no link of the arm's chain, nor fixed to one; those are"
    ):
        read_urdf(tmp_path / "arm.urdf", base="camer")
    with pytest.raises(InputError, match="no joint of the chain turns"):
        read_urdf(tmp_path / "arm.urdf", base="camera")


def test_a_link_that_is_not_there_is_named(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(KR6)
    with pytest.raises(InputError, match=r"no link 'tool1'; the links are base, l1, l2.*; similar is tool0$"):
        read_urdf(tmp_path / "arm.urdf", tip="tool1")
    with pytest.raises(
        InputError, match=r"no link 'hand'; the links are base, l1, l2, l3, l4, l5, l6, tool0, camera$"
    ):
        read_urdf(tmp_path / "arm.urdf", tip="hand")
    with pytest.raises(InputError, match="no such file"):
        read_urdf(tmp_path / "none.urdf")
