"""Why no sphere is seen by two cameras where edges may show one, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

from ronnaplan.geometry import rms_mm
from ronnaplan.robot.stereo.calibration_errors import errors_of, remedy
from ronnaplan.robot.stereo.camera import StereoRig
from ronnaplan.robot.stereo.outline import Cone, Outline


def left_open(
    seen: Sequence[Sequence[Cone | Outline]], rig: StereoRig, diameter_mm: float, largest_mm: float
) -> str:
    """Say that what looks most like a sphere in either image is where cameras are not known to ``largest_mm``, or not.

    A lens that is not known there bends an outline to none, or two to spheres that do not meet.
    """
    errors = errors_of(rig)
    for side, camera, offered in zip(("left", "right"), (rig.left, rig.right), seen, strict=True):
        if errors is None or not offered:
            continue
        direction = camera.rig_from_camera[:3, :3] @ offered[0].direction
        place = camera.center_mm + offered[0].distance_mm(diameter_mm) * direction
        open_mm = float(rms_mm(errors.of_center(rig, place, diameter_mm / 2)))
        if open_mm > largest_mm:
            return (
                f": by {open_mm:.2g} mm the cameras' calibration leaves open where what looks most like one is in the "
                f"{side} image; {remedy(rig, place, diameter_mm / 2)}"
            )
    return ""


def advice(lefts: list[Outline], rights: list[Outline], agreed: bool) -> str:
    """Say what to do where no outlines are of one sphere; ``agreed``: edges in both images are of one."""
    if agreed and lefts and rights:
        return (
            "; edges agree on one in both images, but its outlines do not: take both at one moment, light it evenly "
            "and without gloss up to its limb, and calibrate the cameras anew if they were moved"
        )
    if agreed:
        return (
            "; edges agree on one in both images, but its outline is not a sphere's: bring it into focus, let it and "
            "the cameras rest, and let nothing hide or outshine its limb, or be mirrored in it"
        )
    if lefts and rights:
        return (
            "; check that left and right are of this rig, of one moment, not exchanged, or move the cameras closer"
        )
    return "; move the cameras closer, keep the sphere in both images, and put a plain and darker ground behind it"
