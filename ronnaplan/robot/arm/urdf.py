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
from ronnaplan.text import plain_number
from ronnaplan.untrusted import read_whole

MOST_BYTES = 4 << 20
MM = 1000.0
CONTINUOUS_RAD = 2 * np.pi
"""A joint that turns without end is given a turn either way."""
LARGEST_LIMIT_RAD = 4 * np.pi
"""No joint of an arm turns further either way; limits beyond are in degrees."""
LARGEST_NUMBER = 1e6
"""No length in metres, no angle in rad and no part of an axis is larger; nor is an axis shorter than one over it."""
TURNING = ("revolute", "continuous")
FLANGE = "tool0"
"""What makers' descriptions call the flange, with z pointing out of it."""
MOST_NAMED = 8
"""So many links are named where any may be the flange."""
EXPECTED = "the URDF description of an arm"


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint, and the links of the file that it holds (``child``) and hangs on (``parent``)."""

    name: str
    kind: str
    parent: str
    child: str
    element: ElementTree.Element

    @property
    def turns(self) -> bool:
        """Whether it turns without end, or between limits."""
        return self.kind in TURNING


@dataclass(frozen=True, eq=False)
class UrdfArm:
    """An arm, and the links of which it has no body, or not all: of meshes, or moved by joints outside the chain."""

    arm: SerialArm
    shapeless: tuple[str, ...]


def read_urdf(path: str | os.PathLike[str], *, tip: str | None = None) -> UrdfArm:
    """Read the chain from the file's base link to the flange: ``tip``, else `FLANGE`, else what most joints move.

    What is fixed to the last link becomes a tool of the arm, by its name. Raises `InputError` for what is no URDF, for
    chains with joints that slide or mimic others, and where no ``tip`` is named and several links may be the flange:
    several chains are equally long, or something is fixed to the last link.
    """
    name = os.fspath(path)
    root = _parsed(read_whole(path, MOST_BYTES, expected=EXPECTED), name)
    try:
        return _arm(root, tip)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except ValueError as error:
        raise InputError(f"{name} is damaged ({error}); expected {EXPECTED}") from error


def _parsed(content: bytes, name: str) -> ElementTree.Element:
    try:
        text = content.decode("utf-8-sig")
        if "\0" in text:  # the parser takes them for UTF-16, and no XML holds them
            raise ValueError("it holds null characters")
    except ValueError as error:
        raise InputError(
            f"{name} is not written in UTF-8 ({error}); expected {EXPECTED}, save it as UTF-8"
        ) from error
    if "<!" in text.replace("<!--", ""):
        raise InputError(f"{name} declares a document type or entities; expected {EXPECTED} without them")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"{name} is no XML ({error}); expected {EXPECTED}") from error
    if root.tag != "robot":
        raise InputError(f"{name} holds <{root.tag}>; expected <robot>, {EXPECTED} (run xacro first)")
    if any("xacro" in element.tag or _is_left_to_work_out(element) for element in root.iter()):
        raise InputError(f"{name} holds what xacro has to work out; run xacro first, and give what it writes")
    return root


def _is_left_to_work_out(element: ElementTree.Element) -> bool:
    """Whether an attribute or a text beside ``element`` holds what xacro replaces; comments may."""
    return any("${" in (told or "") for told in (*element.attrib.values(), element.text, element.tail))


def _arm(root: ElementTree.Element, tip: str | None) -> UrdfArm:
    links = _links(root)
    joints = _joints(root, links)
    chain = _chain(joints, tip or _farthest(joints, links), links)
    _require_turning(chain)
    origins, axes, limits, names = [], [], [], []
    before = np.eye(4)
    place: dict[str, tuple[int, FloatArray]] = {chain[0].parent: (0, before)}
    for joint in chain:
        before = before @ _origin(joint.element)
        if joint.turns:
            origins.append(before)
            axes.append(_axis(joint))
            limits.append(_limits(joint))
            names.append(joint.name)
            before = np.eye(4)
        place[joint.child] = (len(names), before)
    if not names:
        raise InputError("no joint of the chain turns; name the link at its end")
    place = _with_fixed(joints, place)
    bodies, shapeless = _bodies(links, place)
    arm = SerialArm(
        _name(root, "the robot") if "name" in root.attrib else "arm",
        tuple(names),
        np.array(origins),
        np.array(axes),
        np.array(limits),
        before,
        bodies,
        {name: np.linalg.inv(before) @ frame for name, (moved, frame) in place.items() if moved == len(names)},
    )
    return UrdfArm(arm, shapeless)


def _links(root: ElementTree.Element) -> dict[str, ElementTree.Element]:
    """Return the links by their names; raises `InputError` where two have one."""
    links: dict[str, ElementTree.Element] = {}
    for link in root.findall("link"):
        name = _name(link, "a link")
        if links.setdefault(name, link) is not link:
            raise InputError(f"two links are called {name!r}; expected each name once, correct the file")
    return links


def _joints(root: ElementTree.Element, links: dict[str, ElementTree.Element]) -> dict[str, _Joint]:
    """Return the joints by the links that they hold; raises `InputError` where two hold one or have one name.

    It also does for a link that is not there.
    """
    joints: dict[str, _Joint] = {}
    names: set[str] = set()
    for element in root.findall("joint"):
        name = _name(element, "a joint")
        if name in names:
            raise InputError(f"two joints are called {name!r}; expected each name once, correct the file")
        names.add(name)
        parent, child = (_named_link(element, end, name, links) for end in ("parent", "child"))
        joint = _Joint(name, _attribute(element, "type", f"joint {name}"), parent, child, element)
        first = joints.setdefault(child, joint)
        if first is not joint:
            raise InputError(
                f"joints {first.name} and {name} carry one link; expected each link on one joint, correct the file"
            )
    return joints


def _named_link(element: ElementTree.Element, end: str, joint: str, links: dict[str, ElementTree.Element]) -> str:
    """Return the link that a joint names as its ``end``, parent or child."""
    found = element.find(end)
    if found is None:
        raise ValueError(f"joint {joint} has no <{end}>")
    link = _attribute(found, "link", f"the {end} of joint {joint}")
    if link not in links:
        raise InputError(f"joint {joint} names the {end} {link!r}, but there is no such link; correct the file")
    return link


def _chain(joints: dict[str, _Joint], tip: str, links: dict[str, ElementTree.Element]) -> list[_Joint]:
    """Return the joints from the base to the link ``tip``."""
    if tip not in links:
        raise InputError(f"there is no link {tip!r}; the links are {', '.join(links) or 'none'}")
    passed: dict[str, _Joint] = {}
    while tip in joints:
        if tip in passed:
            raise _circle(tip)
        passed[tip] = joints[tip]
        tip = joints[tip].parent
    if not passed:
        raise InputError("the chain has no joints; name the link at its end")
    return list(passed.values())[::-1]


def _circle(link: str) -> InputError:
    return InputError(f"the links go round in a circle at {link!r}; expected each one nearer to the base")


def _require_turning(chain: list[_Joint]) -> None:
    for joint in chain:
        mimics = joint.element.find("mimic") is not None
        if mimics or not (joint.turns or joint.kind == "fixed"):
            kind = "mimics another" if mimics else f"is {joint.kind}"
            raise InputError(
                f"joint {joint.name} {kind}; only joints that turn can be planned with: name the flange as "
                "the tip where it comes before"
            )


def _farthest(joints: dict[str, _Joint], links: dict[str, ElementTree.Element]) -> str:
    """Return `FLANGE` where there is one, else the link on the last joint of the chain in which most turn.

    What hangs on a flange, as the fingers of a gripper, is not the arm's. Raises `InputError` naming the links that may
    be the flange, where more than one may.
    """
    if FLANGE in links:
        return FLANGE
    turned = _turned(joints)
    most = max((count for count, _ in turned.values()), default=0)
    if most == 0:
        raise InputError("no joint turns a link; expected a chain of joints")
    farthest = [link for link in links if link in turned and turned[link][0] == most]
    lasts = {turned[link][1] for link in farthest}
    if len(lasts) > 1:
        raise InputError(f"the chains to {', '.join(farthest)} are equally long; name the link at the end")
    last = lasts.pop()
    _require_last(joints, last)
    return last


def _require_last(joints: dict[str, _Joint], last: str) -> None:
    """Raise `InputError` where links are fixed to the ``last`` that turns, as any may be the flange."""
    placed = _with_fixed(joints, {last: (0, np.eye(4))})
    others = [link for link, (_, pose) in placed.items() if not np.allclose(pose, np.eye(4), atol=1e-9)]
    if others:
        more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
        raise InputError(
            f"no link is called {FLANGE}, and other links are fixed to the last that turns, {last}: "
            f"{', '.join(others[:MOST_NAMED])}{more}; name the one that is the flange (`--tip LINK`), {last} or another"
        )


def _turned(joints: dict[str, _Joint]) -> dict[str, tuple[int, str]]:
    """Return of each link on a joint how many joints turn it, and the link on the last of them.

    Each chain is followed up to what is known already, as there may be thousands of links.
    """
    found: dict[str, tuple[int, str]] = {}
    for link in joints:
        new: dict[str, _Joint] = {}
        at = link
        while at in joints and at not in found:
            if at in new:
                raise _circle(at)
            new[at] = joints[at]
            at = joints[at].parent
        count, last = found.get(at, (0, at))
        for held, joint in reversed(new.items()):
            if joint.turns:
                count, last = count + 1, held
            found[held] = count, last
    return found


def _with_fixed(
    joints: dict[str, _Joint], place: dict[str, tuple[int, FloatArray]]
) -> dict[str, tuple[int, FloatArray]]:
    """Return ``place`` (number and pose in it of the chain's links) with every link that is fixed to one of them."""
    fixed: dict[str, list[_Joint]] = {}
    for joint in joints.values():
        if joint.kind == "fixed":
            fixed.setdefault(joint.parent, []).append(joint)
    found = dict(place)
    todo = list(found)
    while todo:
        parent = todo.pop()
        number, frame = found[parent]
        for joint in fixed.get(parent, ()):
            if joint.child not in found:
                found[joint.child] = number, frame @ _origin(joint.element)
                todo.append(joint.child)
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
        told = f"the {kind.tag} of link {name}"
        if kind.tag == "sphere":
            half, radius = np.zeros(3), _length(_attribute(kind, "radius", told))
        elif kind.tag in ("cylinder", "capsule"):
            half = np.array([0.0, 0.0, _length(_attribute(kind, "length", told)) / 2])
            radius = _length(_attribute(kind, "radius", told))
        elif kind.tag == "box":
            size = _attribute(kind, "size", told)
            sides = np.array([_length(side) for side in size.split()]) / 2
            if len(sides) != 3:
                raise ValueError(f"the box '{size}' has no three sides")
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


def _axis(joint: _Joint) -> FloatArray:
    axis = joint.element.find("axis")
    told = "1 0 0" if axis is None else _attribute(axis, "xyz", f"the axis of joint {joint.name}")
    direction = _numbers(told)
    if np.linalg.norm(direction) < 1 / LARGEST_NUMBER:
        raise InputError(f"joint {joint.name} has the axis '{told}'; expected one that points somewhere")
    return unit(direction)


def _limits(joint: _Joint) -> tuple[float, float]:
    limit = joint.element.find("limit")
    if joint.kind == "continuous":
        return -CONTINUOUS_RAD, CONTINUOUS_RAD
    name = joint.name
    if limit is None or not {"lower", "upper"} & set(limit.attrib):
        raise InputError(f"joint {name} has no limits; state them, or call it continuous")
    least, greatest = (plain_number(limit.attrib.get(end, "0")) for end in ("lower", "upper"))
    if least is None or greatest is None:
        raise ValueError(f"a limit of joint {name} is no number")
    if max(abs(least), abs(greatest)) > LARGEST_LIMIT_RAD:
        raise InputError(f"joint {name} has the limits {least:g} to {greatest:g} rad; are they in degrees?")
    return least, greatest


def _attribute(element: ElementTree.Element, key: str, of: str) -> str:
    """Return an attribute that has to be there; raises ValueError that says ``of`` what it is missing."""
    found = element.attrib.get(key)
    if found is None:
        raise ValueError(f"{of} has no {key}")
    return found


def _name(element: ElementTree.Element, of: str) -> str:
    """Return the name of an element, which documents and sentences show in one line; raises `InputError` otherwise."""
    name = _attribute(element, "name", of)
    if not name.strip() or not name.isprintable():
        raise InputError(
            f"{of} is called {name!r}; expected a name that a line of text can show, correct the file"
        )
    return name


def _length(text: str) -> float:
    """Return the size of a shape in mm."""
    length_m = plain_number(text)
    if length_m is None or not 0 < MM * length_m < LARGEST_ARM_MM:
        raise InputError(f"a shape for collisions has the size {text} m; expected one above zero and in metres")
    return MM * length_m


def _numbers(text: str) -> FloatArray:
    numbers = [plain_number(one) for one in text.split()]
    kept = [one for one in numbers if one is not None and abs(one) <= LARGEST_NUMBER]
    if len(numbers) != 3 or len(kept) != 3:
        raise ValueError(f"'{text}' are no three numbers of up to {LARGEST_NUMBER:g}")
    return np.array(kept)
