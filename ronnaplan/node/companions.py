"""What is fetched with a scan, so that its study comes whole: dose reports, pictures of the screen, the node's answers.

A receiver of C-MOVE may take any number of classes. Who asks by C-GET has 128 presentation contexts for all of them:
scans and pictures get one for each transfer syntax, as they may lie in the archive compressed.
"""

from __future__ import annotations

from pynetdicom import ALL_TRANSFER_SYNTAXES, AllStoragePresentationContexts
from pynetdicom.presentation import PresentationContext, build_context

from ronnaplan.ct.header import EXPLICIT_LITTLE, IMPLICIT_LITTLE
from ronnaplan.node.classes import CLASSES, COMPANIONS, OTHER_MODALITIES, PICTURES, PLAIN_SYNTAXES, SYNTAXES


def asked_for() -> list[PresentationContext]:
    """Return in what an archive may send, by C-GET, what a study holds."""
    without_pixels = [one for one in CLASSES if one not in PICTURES]
    return [
        *(build_context(one, syntax) for one in PICTURES for syntax in SYNTAXES),
        *(build_context(one, syntax) for one in without_pixels for syntax in PLAIN_SYNTAXES),
        *(
            build_context(one, [EXPLICIT_LITTLE, IMPLICIT_LITTLE])
            for one in (*COMPANIONS, *OTHER_MODALITIES)
            if one not in PICTURES
        ),
    ]


def taken() -> list[PresentationContext]:
    """Return in what an archive may bring, by C-MOVE, what a study holds: scans as they can be read."""
    standard = (str(one.abstract_syntax) for one in AllStoragePresentationContexts)
    return [
        *(build_context(one, list(SYNTAXES)) for one in CLASSES),
        *(
            build_context(one, ALL_TRANSFER_SYNTAXES)
            for one in sorted({*standard, *COMPANIONS, *OTHER_MODALITIES} - {*CLASSES})
        ),
    ]
