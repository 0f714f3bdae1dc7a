"""Stereo re-localization of one retro-reflective sphere: its center in R with its covariance."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, Points
from ronnaplan.pose import Pose, cross_matrix
from ronnaplan.robot.camera import RIG, Camera, StereoRig
from ronnaplan.robot.chain import TCP, to_frame
from ronnaplan.robot.circles import Image
from ronnaplan.robot.outline import Outline, find_outlines
from ronnaplan.robot.shading import LAMP_SD_DEG

LARGEST_GAP_MM = 0.3
"""Two outlines whose lines of sight pass further from each other than this are not of one sphere."""
SIZE_TOLERANCE = 0.05
"""Largest relative difference of an outline's apparent size from that of the sphere at the place found."""
LARGEST_STATED_MM = 0.02
"""A center whose stated error (RMS) is larger is refused, unless another limit is asked for."""
ITERATIONS = 10


@dataclass(frozen=True, eq=False)
class StereoSphere:
    """The sphere found in both images."""

    position_mm: FloatArray
    """Center (3,) in the rig's frame."""
    covariance_mm2: FloatArray
    """Covariance (3, 3): what the outlines' noise makes of it. The rig's calibration error is not in it."""
    gap_mm: float
    """How far the two lines of sight pass from each other."""
    left: Outline
    right: Outline

    def size_errors(self, rig: StereoRig, diameter_mm: float) -> tuple[float, float]:
        """Return by what part a sphere of ``diameter_mm`` is farther, by its outline in either image, than found."""
        left, right = (
            outline.distance_mm(diameter_mm) / float(np.linalg.norm(self.position_mm - camera.center_mm)) - 1
            for camera, outline in ((rig.left, self.left), (rig.right, self.right))
        )
        return left, right

    def in_robot(self, rig: StereoRig, robot_from_tcp: Pose, label: str = "sphere") -> Points:
        """Return the center in R, with the errors of the outlines, of ``tcp_from_rig`` and of the robot's pose."""
        TCP.require(rig.tcp_from_rig.to_frame)
        here = Points(self.position_mm[None], self.covariance_mm2[None], (label,), RIG)
        return to_frame(robot_from_tcp @ rig.tcp_from_rig, here)


def locate_sphere(
    left: Image,
    right: Image,
    rig: StereoRig,
    *,
    diameter_mm: float,
    largest_mm: float = LARGEST_STATED_MM,
    lamp_sd_deg: float = LAMP_SD_DEG,
) -> StereoSphere:
    """Return the one sphere of ``diameter_mm`` that both images (rows, columns; grey) show.

    Outlines are paired when their lines of sight meet and both have the size of such a sphere there. Raises
    `InputError` if no pair does and `RefusedError` if more than one does, or if the center is not known to
    ``largest_mm`` (RMS). Where the limb is as dark as the ground its place depends on where the lamps are: well
    beside the lenses, or about them and off them by ``lamp_sd_deg``, as seen from the sphere.
    """
    if not (np.isfinite(diameter_mm) and diameter_mm > 0):
        raise InputError(f"a sphere diameter of {diameter_mm} mm was given; expected one above zero")
    with ThreadPoolExecutor(2) as pool:
        lefts, rights = pool.map(find_outlines, (left, right), (rig.left, rig.right), (lamp_sd_deg, lamp_sd_deg))
    found = [
        sphere
        for one in lefts
        for other in rights
        if (sphere := _meet(one, other, rig)) is not None
        and max(map(abs, sphere.size_errors(rig, diameter_mm))) <= SIZE_TOLERANCE
    ]
    if not found:
        raise InputError(
            f"no sphere of {diameter_mm:g} mm is seen by both cameras ({len(lefts)} outlines left, "
            f"{len(rights)} right); move the cameras closer and keep the sphere in both images"
        )
    if len(found) > 1:
        raise RefusedError(f"{len(found)} spheres of {diameter_mm:g} mm are seen by both cameras; expected one")
    stated_mm = float(np.sqrt(np.trace(found[0].covariance_mm2)))
    if not stated_mm <= largest_mm:
        raise RefusedError(
            f"the sphere's center is known to {stated_mm:.3f} mm only; expected {largest_mm:g} mm or less: "
            "light the sphere evenly and brighter than what is behind it, or move the cameras closer"
        )
    return found[0]


def triangulate(rig: StereoRig, left: Outline, right: Outline) -> tuple[FloatArray, FloatArray, float]:
    """Return where two lines of sight meet: position (3,) in the rig, covariance (3, 3), and their gap, mm.

    Minimizes the angles off both lines, each in units of its own covariance (Gauss-Newton).
    """
    origins = np.array([rig.left.center_mm, rig.right.center_mm])
    sights = [_in_rig(rig.left, left), _in_rig(rig.right, right)]
    directions = np.array([direction for direction, _ in sights])
    square = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    weights = square
    for _ in range(ITERATIONS):
        information = weights.sum(axis=0)
        position = np.linalg.solve(information, (weights @ origins[:, :, None]).sum(axis=0)[:, 0])
        distance = np.linalg.norm(position - origins, axis=1)
        weights = np.array(
            [
                np.linalg.pinv(cov, rcond=1e-6, hermitian=True) / d**2
                for (_, cov), d in zip(sights, distance, strict=True)
            ]
        )
    information = weights.sum(axis=0)
    position = np.linalg.solve(information, (weights @ origins[:, :, None]).sum(axis=0)[:, 0])
    normal = np.cross(*directions)
    gap = abs(float(normal @ (origins[1] - origins[0]))) / float(np.linalg.norm(normal))
    return position, np.linalg.inv(information), gap


def _meet(left: Outline, right: Outline, rig: StereoRig) -> StereoSphere | None:
    turn = np.linalg.norm(cross_matrix(_in_rig(rig.left, left)[0]) @ _in_rig(rig.right, right)[0])
    if turn < 1e-3:
        return None
    # the lamps of one rig are mounted alike: what either image tells of them goes for both
    evidence = left.lamp_evidence + right.lamp_evidence
    left, right = left.lit(evidence), right.lit(evidence)
    position, covariance, gap = triangulate(rig, left, right)
    ahead = all(
        (camera.rig_from_camera[:3, 2] @ (position - camera.center_mm)) > 0 for camera in (rig.left, rig.right)
    )
    return StereoSphere(position, covariance, gap, left, right) if ahead and gap <= LARGEST_GAP_MM else None


def _in_rig(camera: Camera, outline: Outline) -> tuple[FloatArray, FloatArray]:
    """Return an outline's direction (3,) and its covariance (3, 3) in the rig's axes."""
    rotation = camera.rig_from_camera[:3, :3]
    return rotation @ outline.direction, rotation @ outline.direction_covariance @ rotation.T
