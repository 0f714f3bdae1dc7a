"""What peers may send, and in which transfer syntaxes: scans, and what lies beside them in a study."""

from __future__ import annotations

from typing import Final

from ronnaplan.ct.header import DEFLATED_LITTLE, EXPLICIT_BIG, EXPLICIT_LITTLE, IMPLICIT_LITTLE
from ronnaplan.ct.uids import CT_IMAGE, ENHANCED_CT, JPEG_LOSSLESS, LEGACY_ENHANCED_CT, PLUGINS

_STORAGE: Final = "1.2.840.10008.5.1.4.1.1."
SEGMENTATION: Final = f"{_STORAGE}66.4"
SECONDARY_CAPTURE: Final = f"{_STORAGE}7"
SCANS: Final = (CT_IMAGE, ENHANCED_CT, LEGACY_ENHANCED_CT)
"""Classes in which markers can be found."""
CLASSES: Final = (
    *SCANS,
    *(f"{_STORAGE}66.{end}" for end in ("1", "2")),  # spatial registration, fiducials
    SEGMENTATION,
    f"{_STORAGE}481.3",  # RT structure set
)
"""Scans, and what is worked with beside them."""
PICTURES: Final = (*SCANS, SEGMENTATION, SECONDARY_CAPTURE)
"""Classes that an archive is asked for in each transfer syntax."""
SYNTAXES: Final = (
    *(EXPLICIT_LITTLE, IMPLICIT_LITTLE, DEFLATED_LITTLE, EXPLICIT_BIG),
    *sorted({*PLUGINS, *JPEG_LOSSLESS}),
)
"""Transfer syntaxes, the preferred one first: those whose pixels are read here."""
PLAIN_SYNTAXES: Final = SYNTAXES[:4]
"""Those of what has no pixels."""
COMPANIONS: Final = (
    *(f"{_STORAGE}88.{end}" for end in ("67", "11", "22", "33", "34", "59", "40")),  # structured reports
    *(f"{_STORAGE}11.{end}" for end in ("1", "2", "3", "4")),  # presentation states
    SECONDARY_CAPTURE,
    *(f"{_STORAGE}7.{end}" for end in ("1", "2", "3", "4")),  # pictures of the screen, of several frames
    *(f"{_STORAGE}{end}" for end in ("104.1", "66", "66.3", "67")),  # PDF, raw data, registration, values
    *(f"{_STORAGE}481.{end}" for end in ("1", "2", "5")),  # radiotherapy: image, dose, plan
    "1.3.12.2.1107.5.9.1",  # a maker's own: CSA non-image
)
"""Classes that studies of heads hold, too. They are kept: a sender calls a study failed where one of them is not."""
RARER_COMPANIONS: Final = tuple(f"{_STORAGE}{end}" for end in ("88.73", "104.3", "66.5", "200.2"))
"""A patient's dose, STL, surfaces, what a scanner did: kept, too; a request by C-GET has no room for them."""
OTHER_MODALITIES: Final = tuple(
    f"{_STORAGE}{end}" for end in ("4", "4.1", "128", "130", "20", "1", "1.1", "12.1", "6.1")
)
"""Classes that a study may hold as well: fetched with it, not taken where a peer sends them."""
