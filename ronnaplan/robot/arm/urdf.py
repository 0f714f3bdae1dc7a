"""Reading an arm from a URDF file: one chain of joints that turn, its limits, its tools, and its simple bodies.

A URDF is a small XML file, so it is read here and no library for it is needed. Lengths in it are metres. Meshes are
not read: `UrdfArm.shapeless` names links that have some, and all others whose shape is not known to the arm.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from difflib import get_close_matches
from xml.etree import ElementTree

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import Body, SerialArm
from ronnaplan.robot.arm.urdf_elements import (
    EXPECTED,
    Joint,
    attribute,
    axis_of,
    joints_of,
    length_mm,
    limits_of,
    links_of,
    name_of,
    origin_of,
    parsed,
    place_of,
)
from ronnaplan.text import listed
from ronnaplan.transforms import invert
from ronnaplan.untrusted import read_whole

MOST_BYTES = 4 << 20
FLANGE = "tool0"
"""What makers' descriptions call the flange, with z pointing out of it."""
BASE = "base"
"""What makers' descriptions call the frame in which their controllers report poses."""
MOST_NAMED = 8
"""So many links are named where any may be the flange."""


@dataclass(frozen=True, eq=False)
class UrdfArm:
    """An arm, and the links of which it has no body, or not all: of meshes, or moved by joints outside the chain.

    ``base_apart`` tells that a link `BASE` stands still elsewhere than what the chain was read from.
    """

    arm: SerialArm
    shapeless: tuple[str, ...]
    base_apart: bool


def read_urdf(path: str | os.PathLike[str], *, tip: str | None = None, base: str | None = None) -> UrdfArm:
    """Read the chain from ``base`` to ``tip``: else the root, and the flange: `FLANGE`, else what most joints move.

    What is fixed to the last link becomes a tool of the arm, by its name. Raises `InputError` for what is no URDF, for
    chains with joints that slide or mimic others, and where no ``tip`` is named and several links may be the flange:
    several chains are equally long, or something is fixed to the last link or moves on it.
    """
    name = os.fspath(path)
    root = parsed(read_whole(path, MOST_BYTES, expected=EXPECTED), name)
    try:
        return _arm(root, tip, base)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except ValueError as error:
        raise InputError(f"{name} is damaged ({error}); expected {EXPECTED}") from error


def _arm(root: ElementTree.Element, tip: str | None, base: str | None) -> UrdfArm:
    links = links_of(root)
    joints = joints_of(root, links)
    chain, before = _from_base(joints, _chain(joints, tip or _farthest(joints, links), links), base)
    _require_turning(chain)
    origins, axes, limits, names = [], [], [], []
    place: dict[str, tuple[int, FloatArray]] = {chain[0].parent: (0, before)}
    for joint in chain:
        before = before @ place_of(joint)
        if joint.turns:
            origins.append(before)
            axes.append(axis_of(joint))
            limits.append(limits_of(joint))
            names.append(joint.name)
            before = np.eye(4)
        place[joint.child] = (len(names), before)
    if not names:
        raise InputError("no joint of the chain turns; name the link at its end")
    place = _with_fixed(joints, place)
    bodies, shapeless = _bodies(links, place)
    tools = {name: np.linalg.inv(before) @ frame for name, (moved, frame) in place.items() if moved == len(names)}
    arm = SerialArm(
        name=name_of(root, "the robot") if "name" in root.attrib else "arm",
        joints=tuple(names),
        origins=np.array(origins),
        axes=np.array(axes),
        limits_rad=np.array(limits),
        flange=before,
        bodies=bodies,
        frames=tools,
        base_link=base or chain[0].parent,
        flange_link=chain[-1].child,
    )
    moved, standing = place.get(BASE, (1, before))
    return UrdfArm(arm, shapeless, moved == 0 and not np.allclose(standing, np.eye(4), atol=1e-6))


def _chain(joints: dict[str, Joint], tip: str, links: dict[str, ElementTree.Element]) -> list[Joint]:
    """Return the joints from the base to the link ``tip``."""
    if tip not in links:
        similar = get_close_matches(tip, links)
        told = f"; similar is {' or '.join(similar)}" if similar else ""
        raise InputError(f"there is no link {tip!r}; the links are {listed(links)}{told}")
    passed: dict[str, Joint] = {}
    while tip in joints:
        if tip in passed:
            raise _circle(tip)
        passed[tip] = joints[tip]
        tip = joints[tip].parent
    if not passed:
        raise InputError("the chain has no joints; name the link at its end")
    return list(passed.values())[::-1]


def _from_base(joints: dict[str, Joint], chain: list[Joint], base: str | None) -> tuple[list[Joint], FloatArray]:
    """Return what of ``chain`` is beyond the joints that move ``base``, and base from the link where that begins."""
    if base is None:
        return chain, np.eye(4)
    top, from_base = base, np.eye(4)
    while top in joints and joints[top].kind == "fixed":
        from_base = place_of(joints[top]) @ from_base
        top = joints[top].parent
    parents = [joint.parent for joint in chain]
    if top not in parents:
        raise InputError(
            f"the base {base!r} is no link of the arm's chain, nor fixed to one; those are {listed(parents)}"
        )
    return chain[parents.index(top) :], invert(from_base)


def _circle(link: str) -> InputError:
    return InputError(f"the links go round in a circle at {link!r}; expected each one nearer to the base")


def _require_turning(chain: list[Joint]) -> None:
    for joint in chain:
        mimics = joint.element.find("mimic") is not None
        if mimics or not (joint.turns or joint.kind == "fixed"):
            kind = "mimics another" if mimics else f"is {joint.kind}"
            raise InputError(
                f"joint {joint.name} {kind}; only joints that turn can be planned with: name the flange as the tip "
                "where it comes before, a link beyond it as the base (`--base LINK`) where that stands still, or call "
                "the joint fixed where it stays"
            )


def _farthest(joints: dict[str, Joint], links: dict[str, ElementTree.Element]) -> str:
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
        raise InputError(
            f"the chains to {listed(farthest, MOST_NAMED)} are equally long and {_parting(joints, *lasts)}; name the "
            "link that is the flange (`--tip LINK`)"
        )
    last = lasts.pop()
    _require_last(joints, last)
    return last


def _parting(joints: dict[str, Joint], first: str, *others: str) -> str:
    """Say which link the chains share last, as the palm of two fingers; each link is followed once, as in `_turned`."""
    way = [first]
    while way[-1] in joints:
        way.append(joints[way[-1]].parent)
    place = {link: n for n, link in enumerate(way)}
    shared, passed = 0, set[str]()
    for link in others:
        while link in joints and link not in place and link not in passed:
            passed.add(link)
            link = joints[link].parent
        if link not in place and link not in passed:
            return "hang on no link in common"
        shared = max(shared, place.get(link, 0))
    return f"part at {way[shared]}"


def _require_last(joints: dict[str, Joint], last: str) -> None:
    """Raise `InputError` where links are fixed to the ``last`` that turns, or move on it, as any may be the flange."""
    placed = _with_fixed(joints, {last: (0, np.eye(4))})
    others = [link for link, (_, pose) in placed.items() if not np.allclose(pose, np.eye(4), atol=1e-9)]
    how = "are fixed to"
    if not others:
        moved = {link: joint for link, joint in joints.items() if joint.parent in placed and link not in placed}
        others = list(moved)
        how = "slide on" if all(joint.kind == "prismatic" for joint in moved.values()) else "move on"
    if others:
        raise InputError(
            f"no link is called {FLANGE}, and other links {how} the last that turns, {last}: "
            f"{listed(others, MOST_NAMED)}; name the one that is the flange (`--tip LINK`), {last} or another"
        )


def _turned(joints: dict[str, Joint]) -> dict[str, tuple[int, str]]:
    """Return of each link on a joint how many joints turn it, and the link on the last of them.

    Each chain is followed up to what is known already, as there may be thousands of links.
    """
    found: dict[str, tuple[int, str]] = {}
    for link in joints:
        new: dict[str, Joint] = {}
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
    joints: dict[str, Joint], place: dict[str, tuple[int, FloatArray]]
) -> dict[str, tuple[int, FloatArray]]:
    """Return ``place`` (number and pose in it of the chain's links) with every link that is fixed to one of them."""
    fixed: dict[str, list[Joint]] = {}
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
                found[joint.child] = number, frame @ place_of(joint)
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
    placed = frame @ origin_of(shape, f"a shape of link {name}")
    geometry = shape.find("geometry")
    for kind in geometry if geometry is not None else ():
        told = f"the {kind.tag} of link {name}"
        if kind.tag == "sphere":
            half, radius = np.zeros(3), length_mm(attribute(kind, "radius", told))
        elif kind.tag in ("cylinder", "capsule"):
            half = np.array([0.0, 0.0, length_mm(attribute(kind, "length", told)) / 2])
            radius = length_mm(attribute(kind, "radius", told))
        elif kind.tag == "box":
            size = attribute(kind, "size", told)
            sides = np.array([length_mm(side) for side in size.split()]) / 2
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
