"""Known markers fitted again in their scan, with what they told of it when they were found."""

from __future__ import annotations

from dataclasses import dataclass

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fiducials import Resolution
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.parameters import full_width_at_half_maximum_mm
from ronnaplan.localization.scanner.scan import Scan, Slant
from ronnaplan.localization.scanner.summed import UNTOLD, Summed
from ronnaplan.localization.scanwide.thick import of_thickness


@dataclass(frozen=True, eq=False)
class KnownScan:
    """A scan of known markers: as its header has it, and ``thick``, its slices as thick as the markers showed."""

    scan: Scan
    thick: Scan

    @classmethod
    def of(cls, volume: CTVolume, seen: Resolution | None) -> KnownScan:
        """Return the scan of a volume in which markers looked as ``seen``; None where that is not known."""
        if seen is None:
            scan = Scan.of(volume)
            return cls(scan, scan)
        width_mm = seen.profile_mm / full_width_at_half_maximum_mm(1.0, seen.shape)
        slant = None if seen.profile_axis is None else Slant(seen.profile_axis, width_mm)
        summed = Summed(first=True, error=0.0) if seen.summed_first else UNTOLD
        scan = Scan.of(volume, slant, summed)
        return cls(scan, of_thickness(scan, width_mm))

    def fit(self, center_mm: FloatArray, diameter_mm: float, build: Build) -> BallFit:
        """Fit the marker at ``center_mm`` (3,), LPS mm; as in thick slices where their header hides that they are."""
        fit = fit_place(self.scan, center_mm, diameter_mm, build)
        return fit if fit.converged else fit_place(self.thick, center_mm, diameter_mm, build)
