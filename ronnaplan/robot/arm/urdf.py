"""Reading an arm from a URDF file: one chain of joints that turn, its limits, its tools, and its simple bodies.

A URDF is a small XML file, so it is read here and no library for it is needed. Lengths in it are metres. Meshes are
not read: `UrdfArm.shapeless` names links that have some, and all others whose shape is not known to the arm.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.pose import rigid
from ronnaplan.robot.arm.arm import LARGEST_ARM_MM, Body, SerialArm
from ronnaplan.untrusted import read_whole

MOST_BYTES = 4 << 20
MM = 1000.0
CONTINUOUS_RAD = 2 * np.pi
"""A joint that turns without end is given a turn either way."""
LARGEST_LIMIT_RAD = 4 * np.pi
"""No joint of an arm turns further either way; limits beyond are in degrees."""
TURNING = ("revolute", "continuous")
FLANGE = "tool0"
"""What makers' descriptions call the flange, with z pointing out of it."""
EXPECTED = "the URDF description of an arm"


@dataclass(frozen=True, eq=False)
class UrdfArm:
    """An arm, and the links of which it has no body, or not all: of meshes, or moved by joints outside the chain."""

    arm: SerialArm
    shapeless: tuple[str, ...]


def read_urdf(path: str | os.PathLike[str], *, tip: str | None = None) -> UrdfArm:
    """Read the chain from the file's base link to the flange: ``tip``, else `FLANGE`, else what most joints move.

    What is fixed to the last link becomes a tool of the arm, by its name. Raises `InputError` for what is no URDF, for
    chains with joints that slide or mimic others, and where several chains are equally long and no ``tip`` is named.
    """
    name = os.fspath(path)
    root = _parsed(read_whole(path, MOST_BYTES, expected=EXPECTED), name)
    try:
        return _arm(root, tip)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise InputError(f"{name} is damaged ({error}); expected {EXPECTED}") from error


def _parsed(content: bytes, name: str) -> ElementTree.Element:
    if b"<!" in content.replace(b"<!--", b""):
        raise InputError(f"{name} declares a document type or entities; expected {EXPECTED} without them")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"{name} is no XML ({error}); expected {EXPECTED}") from error
    if root.tag != "robot":
        raise InputError(f"{name} holds <{root.tag}>; expected <robot>, {EXPECTED} (run xacro first)")
    if b"${" in content or any("xacro" in element.tag for element in root.iter()):
        raise InputError(f"{name} holds what xacro has to work out; run xacro first, and give what it writes")
    return root


def _arm(root: ElementTree.Element, tip: str | None) -> UrdfArm:
    joints: dict[str, ElementTree.Element] = {}
    for joint in root.findall("joint"):
        first = joints.setdefault(joint.find("child").attrib["link"], joint)  # type: ignore[union-attr]
        if first is not joint:
            raise InputError(
                f"joints {first.attrib['name']} and {joint.attrib['name']} carry one link; expected each link on one "
                "joint, correct the file"
            )
    links = {link.attrib["name"]: link for link in root.findall("link")}
    chain = _chain(joints, tip or _farthest(joints, links), links)
    _require_turning(chain)
    origins, axes, limits, names = [], [], [], []
    before = np.eye(4)
    place: dict[str, tuple[int, FloatArray]] = {chain[0].find("parent").attrib["link"]: (0, before)}  # type: ignore[union-attr]
    for joint in chain:
        before = before @ _origin(joint)
        if joint.attrib["type"] in TURNING:
            origins.append(before)
            axes.append(_axis(joint))
            limits.append(_limits(joint))
            names.append(joint.attrib["name"])
            before = np.eye(4)
        place[joint.find("child").attrib["link"]] = (len(names), before)  # type: ignore[union-attr]
    if not names:
        raise InputError("no joint of the chain turns; name the link at its end")
    place = _with_fixed(joints, place)
    bodies, shapeless = _bodies(links, place)
    arm = SerialArm(
        root.attrib.get("name", "arm"),
        tuple(names),
        np.array(origins),
        np.array(axes),
        np.array(limits),
        before,
        bodies,
        {name: np.linalg.inv(before) @ frame for name, (moved, frame) in place.items() if moved == len(names)},
    )
    return UrdfArm(arm, shapeless)


def _chain(
    joints: dict[str, ElementTree.Element], tip: str, links: dict[str, ElementTree.Element]
) -> list[ElementTree.Element]:
    """Return the joints from the base to the link ``tip``."""
    if tip not in links:
        raise InputError(f"there is no link {tip!r}; the links are {', '.join(links) or 'none'}")
    chain: list[ElementTree.Element] = []
    while tip in joints:
        joint = joints[tip]
        if joint in chain:
            raise InputError(f"the links go round in a circle at {tip!r}; expected each one nearer to the base")
        chain.insert(0, joint)
        tip = joint.find("parent").attrib["link"]  # type: ignore[union-attr]
    if not chain:
        raise InputError("the chain has no joints; name the link at its end")
    return chain


def _require_turning(chain: list[ElementTree.Element]) -> None:
    for joint in chain:
        mimics = joint.find("mimic") is not None
        if mimics or joint.attrib["type"] not in (*TURNING, "fixed"):
            kind = "mimics another" if mimics else f"is {joint.attrib['type']}"
            raise InputError(
                f"joint {joint.attrib['name']} {kind}; only joints that turn can be planned with: name the flange as "
                "the tip where it comes before"
            )


def _farthest(joints: dict[str, ElementTree.Element], links: dict[str, ElementTree.Element]) -> str:
    """Return `FLANGE` where there is one, else the link on the last joint of the chain in which most turn.

    What hangs on a flange, as the fingers of a gripper, is not the arm's.
    """
    if FLANGE in links:
        return FLANGE
    moved: dict[str, tuple[str, ...]] = {}
    for link in links:
        if link in joints:
            chain = [joint for joint in _chain(joints, link, links) if joint.attrib["type"] in TURNING]
            moved[link] = tuple(joint.attrib["name"] for joint in chain)
    most = max((len(names) for names in moved.values()), default=0)
    if most == 0:
        raise InputError("no joint turns a link; expected a chain of joints")
    farthest = [link for link, names in moved.items() if len(names) == most]
    if len({moved[link] for link in farthest}) > 1:
        raise InputError(f"the chains to {', '.join(farthest)} are equally long; name the link at the end")
    return next(link for link in farthest if joints[link].attrib["type"] in TURNING)


def _with_fixed(
    joints: dict[str, ElementTree.Element], place: dict[str, tuple[int, FloatArray]]
) -> dict[str, tuple[int, FloatArray]]:
    """Return ``place`` (number and pose in it of the chain's links) with every link that is fixed to one of them."""
    found = dict(place)
    todo = list(found)
    while todo:
        parent = todo.pop()
        for name, joint in joints.items():
            hangs = joint.find("parent").attrib["link"] == parent and joint.attrib["type"] == "fixed"  # type: ignore[union-attr]
            if hangs and name not in found:
                number, frame = found[parent]
                found[name] = number, frame @ _origin(joint)
                todo.append(name)
    return found


def _bodies(
    links: dict[str, ElementTree.Element], place: dict[str, tuple[int, FloatArray]]
) -> tuple[tuple[Body, ...], tuple[str, ...]]:
    """Return the capsules about all shapes, and the links that have others, or are placed by no joint of the arm."""
    bodies: list[Body] = []
    shapeless: list[str] = []
    for name, link in links.items():
        shapes = link.findall("collision")
        number, frame = place.get(name, (0, np.eye(4)))
        found = [body for shape in shapes if (body := _body(name, number, frame, shape)) is not None]
        if name in place:
            bodies += found
        if len(found) < len(shapes) or (shapes and name not in place) or (link.findall("visual") and not shapes):
            shapeless.append(name)
    return tuple(bodies), tuple(shapeless)


def _body(name: str, number: int, frame: FloatArray, shape: ElementTree.Element) -> Body | None:
    """Return the capsule about a cylinder, sphere or box; None for a mesh."""
    placed = frame @ _origin(shape)
    geometry = shape.find("geometry")
    for kind in geometry if geometry is not None else ():
        if kind.tag == "sphere":
            half, radius = np.zeros(3), _length(kind.attrib["radius"])
        elif kind.tag in ("cylinder", "capsule"):
            half = np.array([0.0, 0.0, _length(kind.attrib["length"]) / 2])
            radius = _length(kind.attrib["radius"])
        elif kind.tag == "box":
            sides = np.array([_length(side) for side in kind.attrib["size"].split()]) / 2
            if len(sides) != 3:
                raise ValueError(f"the box '{kind.attrib['size']}' has no three sides")
            longest = int(sides.argmax())
            half = np.where(np.arange(3) == longest, sides, 0.0)
            radius = float(np.linalg.norm(np.delete(sides, longest)))
        else:
            continue
        ends = [placed[:3, 3] + sign * placed[:3, :3] @ half for sign in (-1, 1)]
        return Body(name, number, ends[0], ends[1], float(radius))
    return None


def _origin(element: ElementTree.Element) -> FloatArray:
    from scipy.spatial.transform import Rotation

    origin = element.find("origin")
    given = {} if origin is None else origin.attrib
    turn = Rotation.from_euler("xyz", _numbers(given.get("rpy", "0 0 0"))).as_matrix()
    return rigid(turn, MM * _numbers(given.get("xyz", "0 0 0")))


def _axis(joint: ElementTree.Element) -> FloatArray:
    axis = joint.find("axis")
    return unit(_numbers("1 0 0" if axis is None else axis.attrib["xyz"]))


def _limits(joint: ElementTree.Element) -> tuple[float, float]:
    limit = joint.find("limit")
    if joint.attrib["type"] == "continuous":
        return -CONTINUOUS_RAD, CONTINUOUS_RAD
    name = joint.attrib["name"]
    if limit is None or not {"lower", "upper"} & set(limit.attrib):
        raise InputError(f"joint {name} has no limits; state them, or call it continuous")
    least, greatest = float(limit.attrib.get("lower", "0")), float(limit.attrib.get("upper", "0"))
    if max(abs(least), abs(greatest)) > LARGEST_LIMIT_RAD:
        raise InputError(f"joint {name} has the limits {least:g} to {greatest:g} rad; are they in degrees?")
    return least, greatest


def _length(text: str) -> float:
    """Return the size of a shape in mm."""
    length_mm = MM * float(text)
    if not 0 < length_mm < LARGEST_ARM_MM:
        raise InputError(f"a shape for collisions has the size {text} m; expected one above zero and in metres")
    return length_mm


def _numbers(text: str) -> FloatArray:
    numbers = np.array([float(one) for one in text.split()])
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise ValueError(f"'{text}' are no three numbers")
    return numbers
