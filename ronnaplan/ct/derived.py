"""What images say of their own making: the scanner's slices, images computed from them, or projections.

Read from Image Type (PS3.3 C.7.6.1.1.2, C.8.2.1.1.1, and C.8.16.1 for multi-frame files) with the words that the
makers of scanners and workstations add; the series description, which people type, is heard only for images
that are not original anyway.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Final

from ronnaplan.ct.volume import VolumeFlag

_LOCALIZER: Final = frozenset({"LOCALIZER", "SCOUT", "SURVIEW", "REF_SURVIEW", "TOPOGRAM"})
_PROJECTION: Final = frozenset(
    {*("MIP", "MIPS", "MAX_IP", "MAXIP", "MINIP", "MINIPS", "MIN_IP"), *("MAXIMUM", "MINIMUM", "PROJECTION")}
)
_RENDERED: Final = frozenset({"VRT", "VOLUME_RENDER", "VOLUME_RENDERING", "SURFACE_RENDER", "SSD"})
_CURVED: Final = frozenset({"CURVED", "CURVED_MPR", "CPR"})
_NEVER_SLICES: Final = {
    "a localizer (projection image), not a stack of slices": _LOCALIZER,
    "a maximum or minimum intensity projection, which moves what it shows; choose the slices it was made from": (
        _PROJECTION
    ),
    "a rendered view, not a stack of slices": _RENDERED,
    "a curved reformat, in which distances are not the patient's; choose the slices it was made from": _CURVED,
}
_REFORMATTED: Final = frozenset({"MPR", "REFORMATTED", "REFORMAT", "MULTIPLANAR", "RESAMPLED"})
_VIRTUAL: Final = frozenset(
    {
        *("IODINE", "IODIN", "WATER", "CALCIUM", "URIC", "VNC", "VUE", "VIRTUAL", "MATERIAL"),
        *("MAT_SPECIFIC", "MAT_REMOVED", "MAT_FRACTIONAL", "MAT_VALUE_BASED", "MAT_MODIFIED"),
        *("VMI", "MONO", "MONOE", "MONO_E", "MONOENERGETIC", "MONOCHROMATIC", "KEV"),
        *("EFF_ATOMIC_NUM", "ZEFF", "Z_EFF", "ELECTRON_DENSITY"),
        *("SUBTRACTION", "STD_DEVIATION", "QUANTITY", "DIVISION", "PERFUSION"),
    }
)


@lru_cache(64)  # all slices of a series say the same
def why_not_slices(image_type: tuple[str, ...], technique: str, description: str) -> str | None:
    """Return why an image is no slice of the patient, so that nothing in it may be measured, or None.

    ``technique`` is the Volume Based Calculation Technique of a multi-frame file.
    """
    words = _words(image_type, technique, description)
    return next((reason for reason, telling in _NEVER_SLICES.items() if telling & words), None)


def flags_of(image_type: tuple[str, ...], technique: str, description: str) -> tuple[VolumeFlag, ...]:
    """Return the reasons to doubt an image that was computed from others."""
    words = _words(image_type, technique, description)
    doubts = {
        VolumeFlag.DERIVED: not _is_original(image_type),
        VolumeFlag.REFORMATTED: bool(_REFORMATTED & words),
        VolumeFlag.VIRTUAL_VALUES: bool(_VIRTUAL & words),
    }
    return tuple(flag for flag, holds in doubts.items() if holds)


def told_by_description(image_type: tuple[str, ...], description: str) -> tuple[str, ...]:
    """Return the words by which the description alone tells how an image was made, as values of Image Type."""
    heard = _words(image_type, "", description) - _words(image_type, "", "")
    return tuple(sorted(heard & _REFORMATTED.union(_VIRTUAL, *_NEVER_SLICES.values())))


def _is_original(image_type: tuple[str, ...]) -> bool:
    return image_type[:1] not in (("DERIVED",), ("MIXED",)) and image_type[1:2] != ("SECONDARY",)


def _words(image_type: tuple[str, ...], technique: str, description: str) -> frozenset[str]:
    """Return the values in capitals, and the single words in them: 'CSA MIP' is heard as both."""
    texts = [*image_type, technique, *([] if _is_original(image_type) else [description])]
    capitals = [each.upper() for each in texts]
    return frozenset([*capitals, *(word for each in capitals for word in re.findall(r"[A-Z][A-Z_]*", each))])
