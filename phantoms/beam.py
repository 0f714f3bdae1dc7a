"""The X-ray beam: a tube spectrum and what materials do to it. Needs the extra ``phantoms`` (spekpy, xraydb)."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from phantoms.errors import PhantomError
from phantoms.materials import material
from phantoms.solids import FloatArray

ANODE_ANGLE_DEG = 8.0
FILTRATION_MM = (("Al", 4.0), ("Ti", 0.9))
"""A usual CT tube: tungsten anode, about 8 mm of aluminium half-value layer at 120 kV."""
ENERGY_BINS = 16
"""Bins of equal detected signal; 16 give the transmission of bone and titanium to a few parts in a thousand."""
SCINTILLATOR = (("Gd", 0.785, 7.34, 1.4), ("O", 0.086, 7.34, 1.4), ("S", 0.129, 7.34, 1.4))
"""Gadolinium oxysulfide: element, mass fraction, density in g/cm3, thickness in mm."""
KILOVOLTS = (60.0, 150.0)
"""Voltages at which CT tubes are run, and somewhat beyond."""


@dataclass(frozen=True)
class Beam:
    """Spectrum as the detector weighs it: ``weights`` (B,) of the ``bins`` sum to one."""

    kilovolts: float
    weights: FloatArray
    energies_kev: FloatArray
    """(E,) the fine energies behind the bins"""
    signal: FloatArray
    """(E,) relative detected energy at each fine energy"""
    bins: tuple[slice, ...]
    """Which of the fine energies each bin stands for."""

    def attenuation_per_mm(self, names: tuple[str, ...]) -> FloatArray:
        """Return the attenuation (M, B) of the named materials over that of air, per mm."""
        air = _fine_attenuation(self, "air")
        return np.array([self._binned(_fine_attenuation(self, name) - air) for name in names])

    def _binned(self, fine: FloatArray) -> FloatArray:
        return np.array([np.average(fine[b], weights=self.signal[b]) for b in self.bins])


def check_kilovolts(kilovolts: float) -> None:
    """Raise `PhantomError` unless a CT tube is run at such a voltage."""
    low, high = KILOVOLTS
    if not low <= kilovolts <= high:
        raise PhantomError(f"the tube voltage is {kilovolts} kV; expected {low:.0f} to {high:.0f}")


@lru_cache(maxsize=8)
def tube_beam(kilovolts: float) -> Beam:
    """Return the beam of a usual CT tube, filtered, as seen by an energy-integrating scintillator.

    Spectrum: spekpy (Poludniowski et al., Med Phys 48, 2021); raises `PhantomError` when it is not installed or
    ``kilovolts`` is not in `KILOVOLTS`.
    """
    check_kilovolts(kilovolts)
    spekpy = _require("spekpy")
    tube = spekpy.Spek(kvp=kilovolts, th=ANODE_ANGLE_DEG, dk=1.0)
    for element, thickness in FILTRATION_MM:
        tube.filter(element, thickness)
    energies, fluence = (np.asarray(values, dtype=np.float64) for values in tube.get_spectrum())
    xraydb = _require("xraydb")
    depth = sum(
        xraydb.mu_elam(element, energies * 1e3) * fraction * density * thickness / 10
        for element, fraction, density, thickness in SCINTILLATOR
    )
    signal = fluence * energies * (1 - np.exp(-depth))
    used = signal > 1e-6 * signal.max()
    energies, signal = energies[used], signal[used] / signal[used].sum()
    cuts = np.searchsorted(np.cumsum(signal), np.arange(1, ENERGY_BINS) / ENERGY_BINS)
    bounds = np.unique([0, *cuts, len(signal)])
    bins = tuple(slice(int(a), int(b)) for a, b in pairwise(bounds))
    return Beam(kilovolts, np.array([signal[b].sum() for b in bins]), energies, signal, bins)


def _fine_attenuation(beam: Beam, name: str) -> FloatArray:
    """Return the attenuation (E,) of a material per mm, from xraydb's tables (Elam et al., 2002)."""
    xraydb = _require("xraydb")
    known = material(name)
    total = sum(known.mass_fractions.values())
    energies = np.maximum(beam.energies_kev, 1.0) * 1e3
    mass = sum(xraydb.mu_elam(element, energies) * part for element, part in known.mass_fractions.items())
    return np.asarray(mass, dtype=np.float64) / total * known.density_g_cm3 / 10


def _require(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise PhantomError(
            f"the projection scanner needs {name}, which is not installed; "
            "install the extra 'phantoms' or use the fast scanner"
        ) from error
