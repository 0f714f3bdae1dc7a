"""What is fetched with a scan, so that its study comes whole: dose reports, pictures of the screen, the node's answers.

A receiver of C-MOVE may take any number of classes. Who asks by C-GET has 128 presentation contexts for all of them:
scans and pictures get one for each transfer syntax, as they may lie in the archive compressed.
"""

from __future__ import annotations

from typing import Final

from pynetdicom import ALL_TRANSFER_SYNTAXES, AllStoragePresentationContexts
from pynetdicom.presentation import PresentationContext, build_context

from ronnaplan.ct.header import EXPLICIT_LITTLE, IMPLICIT_LITTLE
from ronnaplan.ct.kinds import CT_IMAGE, ENHANCED_CT, LEGACY_ENHANCED_CT
from ronnaplan.node.receiver import CLASSES, SYNTAXES

_STORAGE: Final = "1.2.840.10008.5.1.4.1.1."
SEGMENTATION: Final = f"{_STORAGE}66.4"
SECONDARY_CAPTURE: Final = f"{_STORAGE}7"
PICTURES: Final = (CT_IMAGE, ENHANCED_CT, LEGACY_ENHANCED_CT, SEGMENTATION, SECONDARY_CAPTURE)
"""Classes that are asked for in each transfer syntax."""
PLAIN_SYNTAXES: Final = SYNTAXES[:4]
"""Those of what has no pixels."""
COMPANIONS: Final = (
    *(f"{_STORAGE}88.{end}" for end in ("67", "11", "22", "33", "34", "59", "40")),  # structured reports
    *(f"{_STORAGE}11.{end}" for end in ("1", "2", "3", "4")),  # presentation states
    *(f"{_STORAGE}7.{end}" for end in ("1", "2", "3", "4")),  # pictures of the screen, of several frames
    *(f"{_STORAGE}{end}" for end in ("104.1", "66", "66.3", "67")),  # PDF, raw data, registration, values
    *(f"{_STORAGE}481.{end}" for end in ("1", "2", "5")),  # radiotherapy: image, dose, plan
    *(
        f"{_STORAGE}{end}" for end in ("4", "4.1", "128", "130", "20", "1", "1.1", "12.1", "6.1")
    ),  # other modalities
    "1.3.12.2.1107.5.9.1",  # a maker's own: CSA non-image
)
"""Classes that studies of heads hold, too; an archive sends them uncompressed."""


def asked_for() -> list[PresentationContext]:
    """Return in what an archive may send, by C-GET, what a study holds."""
    without_pixels = [one for one in CLASSES if one not in PICTURES]
    return [
        *(build_context(one, syntax) for one in PICTURES for syntax in SYNTAXES),
        *(build_context(one, syntax) for one in without_pixels for syntax in PLAIN_SYNTAXES),
        *(build_context(one, [EXPLICIT_LITTLE, IMPLICIT_LITTLE]) for one in COMPANIONS),
    ]


def taken() -> list[PresentationContext]:
    """Return in what an archive may bring, by C-MOVE, what a study holds: scans as they can be read."""
    standard = (str(one.abstract_syntax) for one in AllStoragePresentationContexts)
    return [
        *(build_context(one, list(SYNTAXES)) for one in CLASSES),
        *(build_context(one, ALL_TRANSFER_SYNTAXES) for one in sorted({*standard, *COMPANIONS} - CLASSES.keys())),
    ]
