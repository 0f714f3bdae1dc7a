"""Common SEEG electrodes and DBS leads: where their contacts are, and who says so.

Figures are the makers', as the sources give them; look at the papers of the electrode in your hand before you rely on
them. A directional level counts as one contact: its segments lie at one depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray

LEAD_DBS: Final = "Lead-DBS, ea_resolve_elspec"
OSS_DBS: Final = "OSS-DBS, default electrode parameters"
BRAINSTORM: Final = "Brainstorm, panel_ieeg"


@dataclass(frozen=True)
class Electrode:
    """A straight row of equal contacts, lengths in mm; ``tip_mm`` from the tip to the nearest edge of the first.

    ``gap_mm`` is between the edges of neighbours. ``source`` says where the figures stand.
    """

    name: str
    diameter_mm: float
    contact_mm: float
    gap_mm: float
    count: int
    tip_mm: float
    source: str

    @property
    def from_tip_mm(self) -> FloatArray:
        """How far the middle of each contact (N,) lies from the tip, the deepest first."""
        places: FloatArray = (
            self.tip_mm
            + self.contact_mm / 2
            + (self.contact_mm + self.gap_mm) * np.arange(self.count, dtype=np.float64)
        )
        return places


def _dixi(count: int) -> Electrode:
    return Electrode(f"DIXI D08-{count:02d}AM", 0.8, 2.0, 1.5, count, 0.0, f"{LEAD_DBS}; {OSS_DBS}; {BRAINSTORM}")


def _pmt(count: int) -> Electrode:
    return Electrode(f"PMT 2102-{count:02d}-091", 0.8, 2.0, 1.5, count, 0.0, OSS_DBS)


def _adtech_rd(count: int, pitch_mm: int) -> Electrode:
    name = f"Ad-Tech RD{count:02d}R-SP{pitch_mm:02d}X"
    return Electrode(name, 0.86, 2.29, round(pitch_mm - 2.29, 2), count, 2.0, LEAD_DBS)


def _adtech_sd(count: int) -> Electrode:
    return Electrode(f"Ad-Tech SD{count:02d}R-SP05X", 1.12, 2.41, 2.59, count, 2.0, LEAD_DBS)


def _dbs(name: str, diameter_mm: float, gap_mm: float, count: int, tip_mm: float, note: str = "") -> Electrode:
    return Electrode(name, diameter_mm, 1.5, gap_mm, count, tip_mm, f"{LEAD_DBS}; {OSS_DBS}{note}")


ELECTRODES: Final = {
    one.name: one
    for one in (
        *(_dixi(count) for count in (5, 8, 10, 12, 15, 18)),
        *(_pmt(count) for count in (8, 10, 12, 14, 16)),
        *(_adtech_rd(count, 5) for count in (6, 8, 10)),
        *(_adtech_rd(10, pitch_mm) for pitch_mm in (3, 6, 7, 8)),
        *(_adtech_sd(count) for count in (8, 10)),
        _dbs("Medtronic 3387", 1.27, 1.5, 4, 1.5),
        _dbs("Medtronic 3389", 1.27, 0.5, 4, 1.5),
        _dbs("Medtronic SenSight B33005", 1.36, 0.5, 4, 0.9, " (the larger of two diameters, 1.3 and 1.36)"),
        _dbs("Medtronic SenSight B33015", 1.36, 1.5, 4, 0.9, " (the larger of two diameters, 1.3 and 1.36)"),
        _dbs("Abbott Infinity 6172", 1.29, 0.5, 4, 1.0, " (the larger of two diameters, 1.27 and 1.29)"),
        _dbs("Abbott Infinity 6173", 1.29, 1.5, 4, 1.0, " (the larger of two diameters, 1.27 and 1.29)"),
        _dbs("Boston Scientific Vercise", 1.3, 0.5, 8, 1.1),
        _dbs("Boston Scientific Vercise Directed", 1.3, 0.5, 4, 0.0),
    )
}
"""The known models, by name."""


NO_ELECTRODE: Final = "none"
"""Chosen where nothing stays along the path."""


def electrode_named(name: str) -> Electrode:
    """Return the catalogue's model; raises `InputError` with the known names."""
    try:
        return ELECTRODES[name]
    except KeyError:
        raise InputError(f"unknown electrode {name!r}; expected one of {', '.join(ELECTRODES)}") from None


def electrode_chosen(name: str) -> Electrode | None:
    """Return the catalogue's model, None for `NO_ELECTRODE`; raises `InputError` with the known names."""
    return None if name == NO_ELECTRODE else electrode_named(name)
