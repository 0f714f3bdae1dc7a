"""Which of a URDF's joints are the arm's: one chain from its base to the flange, and what is fixed to that."""

from __future__ import annotations

from difflib import get_close_matches
from xml.etree import ElementTree

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.urdf_elements import Joint, place_of
from ronnaplan.text import listed
from ronnaplan.transforms import invert

FLANGE = "tool0"
"""What makers' descriptions call the flange, with z pointing out of it."""
MOST_NAMED = 8
"""So many links are named where any may be the flange."""


def chain_to(joints: dict[str, Joint], tip: str, links: dict[str, ElementTree.Element]) -> list[Joint]:
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


def from_base(joints: dict[str, Joint], chain: list[Joint], base: str | None) -> tuple[list[Joint], FloatArray]:
    """Return what of ``chain`` is beyond the joints that move ``base``, and (4, 4) base from where that begins."""
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


def require_turning(chain: list[Joint]) -> None:
    """Raise `InputError` naming the first joint of a chain that neither turns nor stays."""
    for joint in chain:
        mimics = joint.element.find("mimic") is not None
        if mimics or not (joint.turns or joint.kind == "fixed"):
            kind = "mimics another" if mimics else f"is {joint.kind}"
            raise InputError(
                f"joint {joint.name} {kind}; only joints that turn can be planned with: name the flange as the tip "
                "where it comes before, a link beyond it as the base (`--base LINK`) where that stands still, or call "
                "the joint fixed where it stays"
            )


def flange_of(joints: dict[str, Joint], links: dict[str, ElementTree.Element]) -> str:
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
    placed = with_fixed(joints, {last: (0, np.eye(4))})
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


def with_fixed(
    joints: dict[str, Joint], place: dict[str, tuple[int, FloatArray]]
) -> dict[str, tuple[int, FloatArray]]:
    """Return ``place`` (number of the chain's links, pose (4, 4) in it) with every link that is fixed to one."""
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
