"""What a serial arm is made of: joints, limits, named frames on its flange, and bodies to keep clear of things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import as_pose
from ronnaplan.text import listed
from ronnaplan.transforms import exponential, rigid, transform_points

LARGEST_ARM_MM = 20_000.0
"""No arm beside a patient has links of twenty metres."""


@dataclass(frozen=True, eq=False)
class Body:
    """A capsule that encloses part of a link: ``start_mm``, ``end_mm`` (3,) in the link's frame and its radius.

    Link 0 is the base, link n the one that joint n moves; the last link carries the flange.
    """

    name: str
    link: int
    start_mm: FloatArray
    end_mm: FloatArray
    radius_mm: float


@dataclass(frozen=True, eq=False)
class HeldJoint:
    """A joint that does not turn: what it would move, link ``link`` of the arm before, is part of the link before it.

    ``pose`` (4, 4) is that link in the one before, with the joint at ``angle_rad``. ``before`` is the arm that still
    turned it.
    """

    joint: str
    angle_rad: float
    link: int
    pose: FloatArray
    before: SerialArm

    def carried(self, body: Body) -> Body:
        """Return ``body``, of the arm before, on the link that carries it now."""
        if body.link < self.link:
            return body
        if body.link > self.link:
            return replace(body, link=body.link - 1)
        start_mm, end_mm = transform_points(self.pose, np.stack([body.start_mm, body.end_mm]))
        return replace(body, link=body.link - 1, start_mm=start_mm, end_mm=end_mm)


@dataclass(frozen=True, eq=False)
class SerialArm:
    """Revolute joints one after the other, in mm and rad.

    ``origins`` (N, 4, 4) place each joint's frame in that of the link before it, at angle zero; the joint turns its
    link about ``axes`` (N, 3), unit vectors in the joint's own frame. ``limits_rad`` (N, 2) are the least and the
    greatest angles. ``flange`` (4, 4) is the flange in the last link; ``frames`` are tools and cameras, each
    ``flange_from_tool`` (4, 4) by name. ``held`` are the joints that were there, in the order in which they were held.
    ``base_link`` and ``flange_link`` are what R and the flange are called where the arm is described.
    """

    name: str
    joints: tuple[str, ...]
    origins: FloatArray
    axes: FloatArray
    limits_rad: FloatArray
    flange: FloatArray = field(default_factory=lambda: np.eye(4))
    bodies: tuple[Body, ...] = ()
    frames: dict[str, FloatArray] = field(default_factory=dict)
    held: tuple[HeldJoint, ...] = ()
    base_link: str = "base"
    flange_link: str = "flange"

    def __post_init__(self) -> None:
        count = len(self.joints)
        for what, array, shape in (
            ("origins", self.origins, (count, 4, 4)),
            ("axes", self.axes, (count, 3)),
            ("limits", self.limits_rad, (count, 2)),
        ):
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(
                    f"{what} of the arm {self.name} have shape {array.shape}; expected finite {shape}"
                )
        if count == 0:
            raise InputError(f"the arm {self.name} has no joints; expected one or more that turn")
        if np.abs(np.linalg.norm(self.axes, axis=1) - 1.0).max() > 1e-9:
            raise InputError(f"an axis of the arm {self.name} is no unit vector; divide each by its length")
        for joint, (least, greatest) in zip(self.joints, self.limits_rad, strict=True):
            if not least < greatest:
                raise InputError(
                    f"joint {joint} of {self.name} has the limits {least:g} to {greatest:g} rad; expected the lower "
                    "one first, and room between them"
                )
        self._require_bodies()
        if np.abs(self.origins[:, :3, 3]).max() > LARGEST_ARM_MM:
            raise InputError(
                f"a link of the arm {self.name} is longer than {LARGEST_ARM_MM:g} mm; are its units mm?"
            )

    def __len__(self) -> int:
        return len(self.joints)

    def _require_bodies(self) -> None:
        for body in self.bodies:
            self._require_link(body, len(self))
            numbers = np.array([*body.start_mm, *body.end_mm, body.radius_mm])
            if not (np.abs(numbers) < LARGEST_ARM_MM).all() or body.radius_mm <= 0:
                raise InputError(
                    f"the body {body.name} of the arm {self.name} has the radius {body.radius_mm:g} mm, or ends that "
                    f"are not finite; expected sizes above zero, up to {LARGEST_ARM_MM:g} mm"
                )

    def _require_link(self, body: Body, last: int) -> None:
        if not 0 <= body.link <= last:
            raise InputError(
                f"the body {body.name} is on link {body.link} of the arm {self.name}; expected 0, the base, to "
                f"{last}, the last that a joint moves"
            )

    def tool(self, name: str) -> FloatArray:
        """Return ``flange_from_tool`` (4, 4); raises `InputError` naming the tools that there are."""
        try:
            return self.frames[name]
        except KeyError:
            raise InputError(
                f"the arm {self.name} carries no tool {name!r}; it carries {listed(self.frames)}"
            ) from None

    def with_tool(self, name: str, flange_from_tool: ArrayLike) -> SerialArm:
        """Return the arm with one more tool or camera frame (4, 4); raises `InputError` for one that is not rigid."""
        return replace(self, frames={**self.frames, name: as_pose(flange_from_tool, f"tool {name}")})

    def holding(self, joint: str, angle_rad: float) -> SerialArm:
        """Return the arm with ``joint`` held at ``angle_rad``: one joint less, and all bodies on the links that remain.

        Raises `InputError` for a joint that it has not, and for an angle beyond the joint's limits.
        """
        if joint not in self.joints:
            others = "".join(f", and holds {one.joint}" for one in self.held)
            raise InputError(
                f"the arm {self.name} turns no joint {joint!r}; it turns {', '.join(self.joints)}{others}"
            )
        n = self.joints.index(joint)
        least, greatest = self.limits_rad[n].tolist()
        if not least <= angle_rad <= greatest:
            raise InputError(
                f"joint {joint} of {self.name} cannot be held at {np.degrees(angle_rad):g} degrees; expected "
                f"{np.degrees(least):g} to {np.degrees(greatest):g}"
            )
        pose = self.origins[n] @ rigid(exponential(angle_rad * self.axes[n]), np.zeros(3))
        held = HeldJoint(joint, angle_rad, n + 1, pose, self)
        following = [*self.origins[n + 1 :], self.flange]
        following[0] = pose @ following[0]
        return replace(
            self,
            joints=(*self.joints[:n], *self.joints[n + 1 :]),
            origins=np.array([*self.origins[:n], *following[:-1]]).reshape(-1, 4, 4),
            axes=np.delete(self.axes, n, axis=0),
            limits_rad=np.delete(self.limits_rad, n, axis=0),
            flange=following[-1],
            bodies=tuple(held.carried(body) for body in self.bodies),
            held=(*self.held, held),
        )

    def with_bodies(self, bodies: Sequence[Body]) -> SerialArm:
        """Return the arm with ``bodies`` in place of its own, their links counted as before any joint was held.

        Raises `InputError` for a body on a link that was not there.
        """
        for body in bodies:
            self._require_link(body, len(self) + len(self.held))
        for held in self.held:
            bodies = [held.carried(body) for body in bodies]
        return replace(self, bodies=tuple(bodies))
