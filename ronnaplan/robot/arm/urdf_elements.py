"""What the elements of a URDF file say, each checked by itself: joints and links, places, axes, limits, lengths."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.robot.arm.arm import LARGEST_ARM_MM
from ronnaplan.text import plain_number
from ronnaplan.transforms import rigid

MM = 1000.0
CONTINUOUS_RAD = 2 * np.pi
"""A joint that turns without end is given a turn either way."""
LARGEST_LIMIT_RAD = 4 * np.pi
"""No joint of an arm turns further either way; limits beyond are in degrees."""
SOFT = ("soft_lower_limit", "soft_upper_limit")
"""What a ``<safety_controller>`` calls the limits that the robot's controller keeps."""
LARGEST_TURN_RAD = 4 * np.pi
"""No description turns a frame further; rpy beyond are in degrees."""
LARGEST_NUMBER = 1e6
"""No part of an axis is larger, nor is an axis shorter than one over it."""
PLACED_BY = frozenset({"xyz", "rpy"})
"""What is read of an origin; newer descriptions may turn it otherwise, too (``quat_xyzw``)."""
ONCE = ("parent", "child", "origin", "axis", "limit", "mimic", "safety_controller")
"""What a joint has one of: of two nothing says which counts."""
TURNING = ("revolute", "continuous")
EXPECTED = "the URDF description of an arm"


@dataclass(frozen=True, eq=False)
class Joint:
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


def parsed(content: bytes, name: str) -> ElementTree.Element:
    """Return the root of a file called ``name``; raises `InputError` where it is no URDF, or one to be worked out."""
    try:
        text = content.decode("utf-8-sig")
        if "\0" in text:  # the parser takes them for UTF-16, and no XML holds them
            raise ValueError("it holds null characters")
    except ValueError as error:
        raise InputError(
            f"{name} is not written in UTF-8 ({error}); expected {EXPECTED}, save it as UTF-8"
        ) from error
    if "<!" in text.replace("<!--", "").replace("<![CDATA[", ""):
        raise InputError(f"{name} declares a document type or entities; expected {EXPECTED} without them")
    try:
        root = _tree(text)
    except (expat.ExpatError, ValueError) as error:
        raise InputError(f"{name} is no XML ({error}); expected {EXPECTED}") from error
    if root.tag != "robot":
        raise InputError(f"{name} holds <{root.tag}>; expected <robot>, {EXPECTED} (run xacro first)")
    xacro = {
        key.partition(":")[2] for key, told in root.attrib.items() if "xacro" in told and key.startswith("xmlns:")
    }
    if any(
        element.tag.partition(":")[0] in {"xacro", *xacro} or _is_left_to_work_out(element)
        for element in root.iter()
    ):
        raise InputError(f"{name} holds what xacro has to work out; run xacro first, and give what it writes")
    return root


def _tree(text: str) -> ElementTree.Element:
    """Return the root of an XML text, its names as they are written.

    Namespaces are not looked up, as ROS does not: many descriptions use some that they never declare (``drake:``,
    ``gz:``), or declare one for all (``xmlns="http://www.ros.org"``).
    """
    builder = ElementTree.TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text, True)
    return builder.close()


def _is_left_to_work_out(element: ElementTree.Element) -> bool:
    """Whether an attribute or a text beside ``element`` holds what xacro replaces; comments may."""
    return any("${" in (told or "") for told in (*element.attrib.values(), element.text, element.tail))


def links_of(root: ElementTree.Element) -> dict[str, ElementTree.Element]:
    """Return the links by their names; raises `InputError` where two have one."""
    links: dict[str, ElementTree.Element] = {}
    for link in root.findall("link"):
        name = name_of(link, "a link")
        if links.setdefault(name, link) is not link:
            raise InputError(f"two links are called {name!r}; expected each name once, correct the file")
    return links


def joints_of(root: ElementTree.Element, links: dict[str, ElementTree.Element]) -> dict[str, Joint]:
    """Return the joints by the links that they hold; raises `InputError` where two hold one or have one name.

    It also does for a link that is not there.
    """
    joints: dict[str, Joint] = {}
    names: set[str] = set()
    for element in root.findall("joint"):
        name = name_of(element, "a joint")
        if name in names:
            raise InputError(f"two joints are called {name!r}; expected each name once, correct the file")
        names.add(name)
        parts = [part.tag for part in element]
        twice = next((tag for tag in ONCE if parts.count(tag) > 1), None)
        if twice is not None:
            raise InputError(f"joint {name} has more than one <{twice}>; expected one, correct the file")
        parent, child = (_named_link(element, end, name, links) for end in ("parent", "child"))
        joint = Joint(name, attribute(element, "type", f"joint {name}"), parent, child, element)
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
    link = attribute(found, "link", f"the {end} of joint {joint}")
    if link not in links:
        raise InputError(f"joint {joint} names the {end} {link!r}, but there is no such link; correct the file")
    return link


def place_of(joint: Joint) -> FloatArray:
    """Return a joint's frame (4, 4) in the link that it hangs on, at angle zero."""
    return origin_of(joint.element, f"joint {joint.name}")


def origin_of(element: ElementTree.Element, of: str) -> FloatArray:
    """Return the pose (4, 4) that an element states; raises ValueError or `InputError` that says ``of`` what."""
    from scipy.spatial.transform import Rotation

    origin = element.find("origin")
    given = {} if origin is None else origin.attrib
    others = sorted(set(given) - PLACED_BY)
    if others:
        raise InputError(
            f"the origin of {of} has {', '.join(map(repr, others))}, which is not read; expected xyz and rpy"
        )
    place_m, turn_rad = (_numbers(given.get(key, "0 0 0"), f"{key} of {of}") for key in ("xyz", "rpy"))
    if np.abs(place_m).max() * MM > LARGEST_ARM_MM:
        raise InputError(f"{of} has the origin {given['xyz']!r} m; is it in mm? Expected metres")
    if np.abs(turn_rad).max() > LARGEST_TURN_RAD:
        raise InputError(f"{of} is turned by rpy {given['rpy']!r} rad; is it in degrees? Expected radians")
    return rigid(Rotation.from_euler("xyz", turn_rad).as_matrix(), MM * place_m)


def axis_of(joint: Joint) -> FloatArray:
    """Return the direction (3,) about which a joint turns; raises `InputError` for one that points nowhere."""
    axis = joint.element.find("axis")
    told = "1 0 0" if axis is None else attribute(axis, "xyz", f"the axis of joint {joint.name}")
    direction = _numbers(told, f"the axis of joint {joint.name}")
    if np.linalg.norm(direction) < 1 / LARGEST_NUMBER:
        raise InputError(f"joint {joint.name} has the axis '{told}'; expected one that points somewhere")
    return unit(direction)


def limits_of(joint: Joint) -> tuple[float, float]:
    """Return a joint's limits in rad, the soft ones that its controller keeps where these are tighter.

    Raises `InputError` where there are none, they look like degrees, or the soft ones leave nothing.
    """
    limit = joint.element.find("limit")
    least, greatest = -CONTINUOUS_RAD, CONTINUOUS_RAD
    if joint.kind != "continuous":
        if limit is None or not {"lower", "upper"} & set(limit.attrib):
            raise InputError(f"joint {joint.name} has no limits; state them, or call it continuous")
        least, greatest = _stated_limits(joint, limit, "limit", ("lower", "upper"))
    soft = joint.element.find("safety_controller")
    if soft is None or not set(SOFT) & set(soft.attrib):
        return least, greatest
    low, high = _stated_limits(joint, soft, "soft limit", SOFT)
    if max(least, low) >= min(greatest, high):
        raise InputError(
            f"joint {joint.name} has the soft limits {low:g} to {high:g} rad, which leave nothing of {least:g} to "
            f"{greatest:g}; correct the <safety_controller>, or take it out"
        )
    return max(least, low), min(greatest, high)


def _stated_limits(
    joint: Joint, element: ElementTree.Element, kind: str, ends: tuple[str, str]
) -> tuple[float, float]:
    """Return the limits in rad that an element states as its ``ends``; one that is left out is zero, as URDF has it."""
    least, greatest = (plain_number(element.attrib.get(end, "0")) for end in ends)
    if least is None or greatest is None:
        raise ValueError(f"a {kind} of joint {joint.name} is no number")
    if max(abs(least), abs(greatest)) > LARGEST_LIMIT_RAD:
        raise InputError(
            f"joint {joint.name} has the {kind}s {least:g} to {greatest:g} rad; are they in degrees? A joint without "
            "limits is called continuous"
        )
    return least, greatest


def attribute(element: ElementTree.Element, key: str, of: str) -> str:
    """Return an attribute that has to be there; raises ValueError that says ``of`` what it is missing."""
    found = element.attrib.get(key)
    if found is None:
        raise ValueError(f"{of} has no {key}")
    return found


def name_of(element: ElementTree.Element, of: str) -> str:
    """Return the name of an element, which documents and sentences show in one line; raises `InputError` otherwise."""
    name = attribute(element, "name", of)
    if not name.strip() or not name.isprintable():
        raise InputError(
            f"{of} is called {name!r}; expected a name that a line of text can show, correct the file"
        )
    return name


def length_mm(text: str) -> float:
    """Return the size of a shape in mm."""
    length_m = plain_number(text)
    if length_m is None or not 0 < MM * length_m < LARGEST_ARM_MM:
        raise InputError(f"a shape for collisions has the size {text} m; expected one above zero and in metres")
    return MM * length_m


def _numbers(text: str, of: str) -> FloatArray:
    numbers = [plain_number(one) for one in text.split()]
    kept = [one for one in numbers if one is not None and abs(one) <= LARGEST_NUMBER]
    if len(numbers) != 3 or len(kept) != 3:
        raise ValueError(f"{of}: '{text}' are no three numbers of up to {LARGEST_NUMBER:g}")
    return np.array(kept)
