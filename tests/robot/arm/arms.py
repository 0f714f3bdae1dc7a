"""Arms as URDF texts, in metres as makers write them, and with the errors that a calibration finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.transforms import exponential, rigid

KR6 = """<robot name="kr6">
  <link name="base"><collision><geometry><mesh filename="base.stl"/></geometry></collision></link>
  <link name="l1"/>
  <link name="l2"><collision><origin xyz="0.2 0 0" rpy="0 1.5707963267948966 0"/>
    <geometry><cylinder length="0.4" radius="0.09"/></geometry></collision></link>
  <link name="l3"><collision><geometry><box size="0.1 0.3 0.2"/></geometry></collision></link>
  <link name="l4"/><link name="l5"><collision><geometry><sphere radius="0.06"/></geometry></collision></link>
  <link name="l6"/><link name="tool0"/><link name="camera"/>
  <joint name="A1" type="revolute"><origin xyz="0 0 0.4"/><parent link="base"/><child link="l1"/>
    <axis xyz="0 0 -1"/><limit lower="-2.9670597283903604" upper="2.9670597283903604"/></joint>
  <joint name="A2" type="revolute"><origin xyz="0.025 0 0"/><parent link="l1"/><child link="l2"/>
    <axis xyz="0 1 0"/><limit lower="-3.3161255787892263" upper="0.7853981633974483"/></joint>
  <joint name="A3" type="revolute"><origin xyz="0.455 0 0"/><parent link="l2"/><child link="l3"/>
    <axis xyz="0 1 0"/><limit lower="-2.0943951023931953" upper="2.722713633111154"/></joint>
  <joint name="A4" type="revolute"><origin xyz="0 0 0.035"/><parent link="l3"/><child link="l4"/>
    <axis xyz="-1 0 0"/><limit lower="-3.2288591161895095" upper="3.2288591161895095"/></joint>
  <joint name="A5" type="revolute"><origin xyz="0.42 0 0"/><parent link="l4"/><child link="l5"/>
    <axis xyz="0 1 0"/><limit lower="-2.0943951023931953" upper="2.0943951023931953"/></joint>
  <joint name="A6" type="revolute"><origin xyz="0.08 0 0"/><parent link="l5"/><child link="l6"/>
    <axis xyz="-1 0 0"/><limit lower="-6.1086523819801535" upper="6.1086523819801535"/></joint>
  <joint name="flange" type="fixed"><origin rpy="0 1.5707963267948966 0"/><parent link="l6"/>
    <child link="tool0"/></joint>
  <joint name="mount" type="fixed"><origin xyz="0 0.1 0.05"/><parent link="tool0"/><child link="camera"/></joint>
</robot>"""
"""The KR 6 R900's chain, with a camera on its flange."""

TILTED = """<robot name="tilted">
  <link name="b"/><link name="a"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="l4"/><link name="l5"/>
  <link name="l6"/><link name="tip"/>
  <joint name="foot" type="fixed"><origin xyz="0.1 0.2 0.05" rpy="0.3 -0.2 0.9"/><parent link="b"/>
    <child link="a"/></joint>
  <joint name="j1" type="revolute"><origin xyz="0 0 0.3"/><parent link="a"/><child link="l1"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3"/></joint>
  <joint name="j2" type="revolute"><origin xyz="0.15 0.08 0.1" rpy="-1.5707963267948966 0 0"/>
    <parent link="l1"/><child link="l2"/><axis xyz="0 0 1"/><limit lower="-2.5" upper="2"/></joint>
  <joint name="j3" type="revolute"><origin xyz="0.1 -0.45 0" rpy="0 0 0.4"/><parent link="l2"/><child link="l3"/>
    <axis xyz="0 0 -1"/><limit lower="-2.5" upper="2.5"/></joint>
  <joint name="j4" type="revolute"><origin xyz="0.07 -0.1 0.06" rpy="1.5707963267948966 0 0"/>
    <parent link="l3"/><child link="l4"/><axis xyz="0 0 1"/><limit lower="-4" upper="4"/></joint>
  <joint name="j5" type="continuous"><origin xyz="0 0 0.36" rpy="0 0 0.7"/><parent link="l4"/><child link="l5"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="j6" type="revolute"><origin xyz="0 0 0" rpy="0 0.5 0"/><parent link="l5"/><child link="l6"/>
    <axis xyz="0 0 1"/><limit lower="-6" upper="6"/></joint>
  <joint name="end" type="fixed"><origin xyz="0.01 0.02 0.09" rpy="0.1 0.2 0.3"/><parent link="l6"/>
    <child link="tip"/></joint>
</robot>"""
"""A spherical wrist on everything askew: a tilted foot, a lateral offset, an axis 3 against axis 2, a bent zero."""

HALF = "1.5707963267948966"
UR5E_M = (0.1625, 0.425, 0.3922, 0.1333, 0.0997, 0.0996)
UR10E_M = (0.1807, 0.6127, 0.57155, 0.17415, 0.11985, 0.11655)
"""The maker's lengths: of the foot, upper arm and forearm, and from axis 3 to axis 5, 5 to 6 and 6 to the flange."""


def ur(lengths_m: tuple[float, ...]) -> str:
    """Return a UR-like arm of such lengths: axes 2, 3 and 4 are parallel, and only axes 5 and 6 meet."""
    foot, upper, fore, side, wrist, end = lengths_m
    return _ur(
        lengths_m,
        (f"0 0 {foot}", "0 0 0"),
        ("0 0 0", f"{HALF} 0 0"),
        (f"{-upper} 0 0", "0 0 0"),
        (f"{-fore} 0 {side}", "0 0 0"),
        (f"0 {-wrist} 0", f"{HALF} 0 0"),
        (f"0 {end} 0", f"-{HALF} 0 0"),
    )


def calibrated_ur5e() -> str:
    """Return a UR5e with the errors of one that left its factory: axes 3 and 4 are 0.003 rad from parallel."""
    return _ur(
        UR5E_M,
        ("0 0 0.162712", "0 0 0"),
        ("0.000182 0 0", "1.571315 0 0.000001"),
        ("-0.425170 0 0", "0.001444 -0.000426 0.000005"),
        ("-0.392647 -0.000403 0.133106", "0.003028 -0.001186 -0.000003"),
        ("-0.000007 -0.099604 0", "1.570800 0 0.000001"),
        ("0.000014 0.099585 0.000095", f"1.571752 {2 * float(HALF)} {2 * float(HALF)}"),
    )


def calibrated(arm: SerialArm, seed: int, off_rad: float = 1e-3, off_mm: float = 0.3) -> SerialArm:
    """Return ``arm`` with every joint's frame turned and moved at random by up to so much about and along each axis."""
    rng = np.random.default_rng(seed)
    turns, ways = rng.uniform(-off_rad, off_rad, (len(arm), 3)), rng.uniform(-off_mm, off_mm, (len(arm), 3))
    return replace(arm, name=f"{arm.name}, calibrated", origins=arm.origins @ rigid(exponential(turns), ways))


def _ur(lengths_m: tuple[float, ...], *frames: tuple[str, str]) -> str:
    """Return a UR-like arm of such ``lengths_m``, whose six joints have such ``frames``, place and turn."""
    foot, upper, fore, side, _, _ = lengths_m
    names = ("pan", "lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    limits = (6.2831, 6.2831, 3.1415, 6.2831, 6.2831, 6.2831)
    joints = [
        (name, *frame, -limit, limit, "0 0 1") for name, frame, limit in zip(names, frames, limits, strict=True)
    ]
    shapes = (
        _tube(f"0 0 {foot / 2}", foot / 2, 0.09),
        "",
        _tube(f"{-upper / 2} 0 {side}", upper, 0.07, f"0 {HALF} 0"),
        _tube(f"{-fore / 2} 0 0.03", fore, 0.06, f"0 {HALF} 0"),
        _tube("0 0 0", 0.08, 0.05),
        _tube("0 0 0", 0.08, 0.05),
        "",
    )
    return _described("ur", shapes, joints, "0 0 0")


IIWA_M = (0.36, 0.42, 0.4, 0.126)
"""The maker's lengths of the LBR iiwa 14 R820: to the shoulder, elbow, wrist and flange, all in one line at zero."""


def iiwa() -> str:
    """Return that arm: seven joints, whose axes are along z and y in turn."""
    foot, upper, fore, end = IIWA_M
    up = (foot / 2, foot / 2, upper / 2, upper / 2, fore / 2, fore / 2, 0.0)
    axes = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 1 0", "0 0 1")
    limits = np.radians([170, 120, 170, 120, 170, 120, 175]).tolist()
    joints = [
        (f"joint_a{n}", f"0 0 {z}", "0 0 0", -limit, limit, axis)
        for n, (z, limit, axis) in enumerate(zip(up, limits, axes, strict=True), start=1)
    ]
    lengths = (0.12, 0.0, 0.12, 0.12, 0.12, 0.12, 0.0, 0.0)
    shapes = [_tube(f"0 0 {length / 2}", length, 0.08) if length else "" for length in lengths]
    return _described("iiwa", shapes, joints, f"0 0 {end}")


PANDA_M = (0.333, 0.316, 0.0825, 0.384, 0.088, 0.107)
"""The maker's lengths of Franka's arms: to shoulder, elbow and aside to it, wrist, aside to axis 7, and flange."""


def panda() -> str:
    """Return that arm: axes 1, 2 and 3 meet, and 5 and 6; axis 4 passes both beside, and axis 7 the wrist."""
    foot, upper, aside, fore, hand, end = PANDA_M
    joints = [
        ("panda_joint1", f"0 0 {foot}", "0 0 0", -2.8973, 2.8973, "0 0 1"),
        ("panda_joint2", "0 0 0", f"-{HALF} 0 0", -1.7628, 1.7628, "0 0 1"),
        ("panda_joint3", f"0 {-upper} 0", f"{HALF} 0 0", -2.8973, 2.8973, "0 0 1"),
        ("panda_joint4", f"{aside} 0 0", f"{HALF} 0 0", -3.0718, -0.0698, "0 0 1"),
        ("panda_joint5", f"{-aside} {fore} 0", f"-{HALF} 0 0", -2.8973, 2.8973, "0 0 1"),
        ("panda_joint6", "0 0 0", f"{HALF} 0 0", -0.0175, 3.7525, "0 0 1"),
        ("panda_joint7", f"{hand} 0 0", f"{HALF} 0 0", -2.8973, 2.8973, "0 0 1"),
    ]
    shapes = (
        _tube("0 0 0.1", 0.1, 0.06),
        "",
        "",
        _tube(f"0 0 {-upper / 2}", 0.1, 0.06),
        "",
        _tube(f"0 0 {-fore / 2}", 0.2, 0.06),
        _tube("0 0 0", 0.06, 0.05),
        "",
    )
    return _described("panda", shapes, joints, f"0 0 {end}")


def _tube(at: str, length_m: float, radius_m: float, turn: str = "0 0 0") -> str:
    return (
        f'<collision><origin xyz="{at}" rpy="{turn}"/><geometry><cylinder length="{length_m}" radius="{radius_m}"/>'
        "</geometry></collision>"
    )


def _described(name: str, shapes: Sequence[str], joints: Sequence[tuple[object, ...]], flange: str) -> str:
    """Return the URDF of links of such ``shapes`` on ``joints`` (name, place, turn, both limits, axis)."""
    links = "".join(f'<link name="l{n}">{shape}</link>' for n, shape in enumerate(shapes))
    turning = "".join(
        f'<joint name="{joint}" type="revolute"><origin xyz="{at}" rpy="{turn}"/><parent link="l{n}"/>'
        f'<child link="l{n + 1}"/><axis xyz="{axis}"/><limit lower="{least}" upper="{greatest}"/></joint>'
        for n, (joint, at, turn, least, greatest, axis) in enumerate(joints)
    )
    end = (
        f'<link name="tool0"/><joint name="end" type="fixed"><origin xyz="{flange}"/><parent link="l{len(joints)}"/>'
        '<child link="tool0"/></joint>'
    )
    return f'<robot name="{name}">{links}{turning}{end}</robot>'


_LINKS = "".join(f'<link name="l{n}"/>' for n in range(8))
_JOINT = """<joint name="j{n}" type="revolute"><origin xyz="0 0 0.17" rpy="{turn} 0 0"/>
  <parent link="l{before}"/><child link="l{n}"/><axis xyz="0 0 1"/><limit lower="-2.6" upper="2.6"/></joint>
"""
_JOINTS = "".join(
    _JOINT.format(n=n, before=n - 1, turn="1.5707963267948966" if n % 2 == 0 else "-1.2") for n in range(1, 8)
)
SEVEN = f'<robot name="seven">{_LINKS}{_JOINTS}</robot>'


def hanging(text: str) -> str:
    """Return an arm's description whose link ``base`` hangs upside down under the root."""
    start, _, rest = text.partition("\n")
    return (
        f'{start}<link name="ceiling"/><joint name="hook" type="fixed"><origin rpy="3.141592653589793 0 0"/>'
        f'<parent link="ceiling"/><child link="base"/></joint>\n{rest}'
    )
