"""What would make a scan better for its markers: settings to change, and why, from what its markers look like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.ct.grid import SliceGrid
from ronnaplan.localization.fiducials import FiducialFlag, Fiducials
from ronnaplan.localization.fit.parameters import EDGE

THICK_SHARE = 0.12
"""Slice profiles up to this share of the diameter leave nothing to gain (1.25 mm for 11.5 mm); those of 2 mm and more
cost half as much error again, those of 5 mm four times as much (docs/localization.md)."""

SOFT_SHARE = 0.08
"""Kernels that blur by more than this share of the diameter (0.9 mm for 11.5 mm) are softer than need be."""

ENHANCING = 0.5
"""Kernels that overshoot by more than this at edges are for bone's edges, not for its places."""

COARSE_SHARE = 0.06
"""Pixels larger than this share of the diameter (0.7 mm for 11.5 mm) are coarser than need be."""


@dataclass(frozen=True)
class Advice:
    """A ``setting`` as it was ``found``, what it had better be (``advised``), and the ``reason``, each in words."""

    setting: str
    found: str
    advised: str
    reason: str


def recommended_settings(grid: SliceGrid, found: Fiducials) -> tuple[Advice, ...]:
    """Return what to change of a scan with this ``grid`` and these markers; empty where nothing is to be gained."""
    seen = found.resolution
    if seen is None:
        return ()
    smallest_mm = min(found.diameters_mm)
    thick_mm, coarse_mm = THICK_SHARE * smallest_mm, COARSE_SHARE * smallest_mm
    pixel_mm = grid.pixel_mm
    edge = float(np.median([one.parameters[EDGE] for one in found.fiducials]))
    advice = []
    if seen.profile_mm > thick_mm:
        wide = f"{seen.profile_mm:.2f} mm at half height"
        why = f"it blurs more than {THICK_SHARE:.0%} of a marker's {smallest_mm:g} mm across the slices"
        advice.append(Advice("slice thickness", wide, f"{thick_mm:.2g} mm or thinner", why))
    if seen.blur_mm > SOFT_SHARE * smallest_mm:
        why = f"it blurs edges by more than {SOFT_SHARE:.0%} of a marker's diameter"
        advice.append(Advice("kernel", f"blur of {seen.blur_mm:.2f} mm", "a standard or detail kernel", why))
    elif edge > ENHANCING:
        why = "it overshoots at edges, which brings noise and no place"
        advice.append(Advice("kernel", f"edge enhancement of {edge:.1f}", "a standard kernel", why))
    if pixel_mm > coarse_mm:
        why = f"pixels are larger than {COARSE_SHARE:.0%} of a marker's diameter"
        smaller = f"pixels of {coarse_mm:.2g} mm or less, if the head still fits"
        advice.append(Advice("field of view", f"{pixel_mm:.2f} mm", smaller, why))
    return (*advice, *_of_flags(found))


def _of_flags(found: Fiducials) -> list[Advice]:
    """Advice for what the markers' flags say."""
    remedies = {
        FiducialFlag.GAPPED: ("slice spacing", "slices no farther apart than they are thick"),
        FiducialFlag.CUT: ("scan length", "20 mm beyond the outermost markers"),
        FiducialFlag.CLIPPED: ("scale", "the extended scale (16 bit), if the scanner offers it"),
        FiducialFlag.DIAMETER: ("--diameter", "the diameter as a caliper gives it, and markers without a film"),
        FiducialFlag.MOTION_SUSPECTED: ("patient", "a head that is held, and a shorter scan"),
        FiducialFlag.COVERED: ("markers", "nothing on them: no tape, hair or cloth"),
    }
    advice = []
    for flag, (setting, remedy) in remedies.items():
        labels = [one.label for one in found.fiducials if flag in one.flags]
        if labels:
            advice.append(Advice(setting, f"{', '.join(labels)}: {flag.name.lower()}", remedy, str(flag)))
    return advice
