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
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import Body, SerialArm
from ronnaplan.robot.arm.urdf_chain import chain_to, flange_of, from_base, require_turning, with_fixed
from ronnaplan.robot.arm.urdf_elements import (
    EXPECTED,
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
from ronnaplan.untrusted import read_whole

MOST_BYTES = 4 << 20
BASE = "base"
"""What makers' descriptions call the frame in which their controllers report poses."""


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
    chain, before = from_base(joints, chain_to(joints, tip or flange_of(joints, links), links), base)
    require_turning(chain)
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
    place = with_fixed(joints, place)
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
