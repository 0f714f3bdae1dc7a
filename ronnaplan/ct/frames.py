"""From a file's header to its images: one of a classic CT, many of an Enhanced (multi-frame) CT.

`why_not_scan` says what keeps a file from being part of a CT volume.
"""

from __future__ import annotations

import re
import struct
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, Literal

from ronnaplan.bounds import LARGEST_HU
from ronnaplan.ct import tags
from ronnaplan.ct.codecs import why_not_decoded
from ronnaplan.ct.derived import why_not_slices
from ronnaplan.ct.files import DamagedError
from ronnaplan.ct.fragments import frame_fragments, require_order
from ronnaplan.ct.header import (
    DEFLATED_LITTLE,
    EXPLICIT_BIG,
    EXPLICIT_LITTLE,
    IMPLICIT_LITTLE,
    Elements,
)
from ronnaplan.ct.limits import DEFAULT_LIMITS, LARGE_DEFLATED
from ronnaplan.ct.slices import MULTI_FRAME_CLASSES, Instance, PixelFormat, SliceImage
from ronnaplan.ct.values import Vector, number_or_none, numbers, text, values

_NO_SCANS: Final = {
    "1.2.840.10008.1.3.10": "a DICOMDIR index",
    "1.2.840.10008.5.1.4.1.1.7": "a secondary capture, not a scan",
    "1.2.840.10008.5.1.4.1.1.7.1": "a secondary capture, not a scan",
    "1.2.840.10008.5.1.4.1.1.7.2": "a secondary capture, not a scan",
    "1.2.840.10008.5.1.4.1.1.7.3": "a secondary capture, not a scan",
    "1.2.840.10008.5.1.4.1.1.7.4": "a secondary capture, not a scan",
    "1.2.840.10008.5.1.4.1.1.481.2": "a radiotherapy dose (RTDOSE), not a scan",
    "1.2.840.10008.5.1.4.1.1.481.3": "a structure set (RTSTRUCT), not a scan",
    "1.2.840.10008.5.1.4.1.1.481.5": "a radiotherapy plan (RTPLAN), not a scan",
    "1.2.840.10008.5.1.4.1.1.66": "raw data, not a scan",
    "1.2.840.10008.5.1.4.1.1.66.4": "a segmentation (SEG), not a scan",
    "1.2.840.10008.5.1.4.1.1.88.67": "a radiation dose report (SR), not a scan",
    "1.2.840.10008.5.1.4.1.1.104.1": "an encapsulated PDF, not a scan",
}
_STRUCTURED_REPORT_PREFIX: Final = "1.2.840.10008.5.1.4.1.1.88."
_PRESENTATION_STATE_PREFIX: Final = "1.2.840.10008.5.1.4.1.1.11."
PLAIN_SYNTAXES: Final = frozenset({IMPLICIT_LITTLE, EXPLICIT_LITTLE, EXPLICIT_BIG, DEFLATED_LITTLE})
MOST_FRAMES: Final = 20_000
"""A file of more frames than this (20 m of body at 1 mm) is taken for damage."""
INTEGER_BYTES: Final = 4
"""DICOM's integers are of two or four; of a damaged one no more is looked at."""
_HU_NAMES: Final = frozenset({"", "HU", "US", "HOUNSFIELD", "HOUNSFIELD UNIT", "HOUNSFIELD UNITS"})
"""Rescale types taken for HU. ``US`` (unspecified) is the standard's default for a CT; some spell it out."""


def why_not_scan(instance: Instance, kinds: Mapping[str, frozenset[str]]) -> str | None:
    """Return why a file cannot be a part of a volume of the modalities and classes in ``kinds``, or None."""
    if instance.sop_class in _NO_SCANS:
        return _NO_SCANS[instance.sop_class]
    if instance.sop_class.startswith(_STRUCTURED_REPORT_PREFIX):
        return "a structured report (SR), not a scan"
    if instance.sop_class.startswith(_PRESENTATION_STATE_PREFIX):
        return "a presentation state, not a scan"
    if instance.modality not in kinds:
        return f"the modality is {instance.modality or 'not given'}, not {' or '.join(kinds)}"
    if instance.sop_class not in kinds[instance.modality]:
        article = "an" if instance.modality == "MR" else "a"
        return f"the SOP class {instance.sop_class} is not {article} {instance.modality} image"
    return why_not_slices(instance.image_type, instance.technique, instance.description)


def _why_not_pixels(pixels: PixelFormat) -> str | None:
    if pixels.fault is not None:
        return pixels.fault
    if pixels.samples != 1:
        return "a colour picture, not a scan; leave it out"
    if pixels.photometric != "MONOCHROME2":
        return f"its photometric interpretation is {pixels.photometric}, expected MONOCHROME2"
    if pixels.tag == tags.PIXEL_DATA:
        if pixels.bits_allocated not in (8, 16, 32):
            return f"its pixels take {pixels.bits_allocated} bits, expected 8, 16 or 32"
        if not 1 <= pixels.bits_stored <= pixels.bits_allocated or pixels.high_bit != pixels.bits_stored - 1:
            return (
                f"its pixels store {pixels.bits_stored} bits up to bit {pixels.high_bit} "
                f"of {pixels.bits_allocated}, expected the low bits"
            )
    if pixels.length is None:
        return why_not_decoded(pixels)
    return _why_not_plain(pixels, pixels.length)


def _why_not_plain(pixels: PixelFormat, length: int) -> str | None:
    if pixels.transfer_syntax not in PLAIN_SYNTAXES:
        plain = f"its transfer syntax {pixels.transfer_syntax} should be encapsulated but is not"
        return why_not_decoded(pixels) or plain
    is_deflated = pixels.transfer_syntax == DEFLATED_LITTLE
    if is_deflated and pixels.frames > 1 and length > DEFAULT_LIMITS.header_bytes:
        return LARGE_DEFLATED
    declared = pixels.frame_bytes * pixels.frames
    if not declared <= length <= declared + declared % 2:  # a value is filled up to an even length
        return f"it declares {declared} bytes of pixels but holds {length}; copy it again"
    return None


def images_of(instance: Instance) -> list[SliceImage]:
    """Return the images of a file that passed `why_not_scan`; raises `DamagedError` naming what is missing."""
    pixels = instance.pixels
    if pixels is None:
        raise DamagedError("it holds no pixels")
    reason = _why_not_pixels(pixels)
    if reason is not None:
        raise DamagedError(reason)
    if instance.elements.get(tags.MODALITY_LUT_SEQUENCE):  # empty as some programs leave it, it says nothing
        raise DamagedError("its values need a modality LUT, not a rescale slope and intercept")
    facts = _facts_of_frames(instance, pixels)
    images = [_image(instance, pixels, frame, each) for frame, each in enumerate(facts)]
    if pixels.length is None:
        require_order(instance.elements.get(tags.EXTENDED_OFFSET_TABLE, b""))
        places = frame_fragments(instance.blob, pixels)
        images = [replace(image, fragments=place) for image, place in zip(images, places, strict=True)]
    return images


def _facts_of_frames(instance: Instance, pixels: PixelFormat) -> list[Elements]:
    """Return, for each frame, the elements that describe it at one level."""
    frames = instance.elements.get(tags.PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, [])
    if instance.sop_class not in MULTI_FRAME_CLASSES and not frames:
        if pixels.frames != 1:
            raise DamagedError(f"it holds {pixels.frames} frames without saying where each one is")
        return [instance.elements]
    if pixels.frames > MOST_FRAMES:
        raise DamagedError(f"it declares {pixels.frames} frames, more than {MOST_FRAMES}")
    if len(frames) != pixels.frames:
        raise DamagedError(f"it declares {pixels.frames} frames but describes {len(frames)}")
    shared_groups = instance.elements.get(tags.SHARED_FUNCTIONAL_GROUPS_SEQUENCE, [])
    if len(shared_groups) > 1:
        raise DamagedError(f"it holds {len(shared_groups)} sets of shared functional groups, expected one")
    shared = _flatten(shared_groups)
    return [_flatten([shared, groups]) for groups in frames]


def _flatten(groups: list[Elements]) -> Elements:
    """Bring functional groups to one level; each holds one item, and says nothing that another says otherwise."""
    flat: Elements = {}
    for group in groups:
        for tag, value in group.items():
            items = value if isinstance(value, list) else [{tag: value}]
            if tag == tags.CT_X_RAY_DETAILS_SEQUENCE:
                items = _shared_by(items)
            if len(items) > 1:
                raise DamagedError(
                    f"its functional group {tags.element_name(tag)} has {len(items)} items, expected one"
                )
            for inner, raw in [pair for item in items for pair in item.items()]:
                if not isinstance(raw, list) and flat.setdefault(inner, raw) != raw:
                    raise DamagedError(f"a frame gives element {tags.element_name(inner)} twice, with two values")
    return flat


def _shared_by(sources: list[Elements]) -> list[Elements]:
    """Return what holds for each of several tubes: the rays of all made one image (PS3.3, C.8.15.3.9)."""
    first, *others = sources or [{}]
    return [{tag: value for tag, value in first.items() if all(one.get(tag) == value for one in others)}]


def _image(instance: Instance, pixels: PixelFormat, frame: int, facts: Elements) -> SliceImage:
    slope, intercept = _rescale(facts) if instance.modality == "CT" else _stored_scale(facts)
    image_type = values(facts, tags.FRAME_TYPE) or instance.image_type
    technique = text(facts, tags.VOLUME_BASED_CALCULATION_TECHNIQUE) or instance.technique
    reason = why_not_slices(image_type, technique, instance.description)
    if reason is not None:
        raise DamagedError(f"its frame {frame + 1} is {reason}")
    return SliceImage(
        instance=instance,
        pixels=pixels,
        frame=frame,
        origin_mm=_required(facts, tags.IMAGE_POSITION_PATIENT, 3, "position"),
        orientation=_required(facts, tags.IMAGE_ORIENTATION_PATIENT, 6, "orientation"),
        spacing_mm=_required(facts, tags.PIXEL_SPACING, 2, "pixel spacing"),
        slope=slope,
        intercept=intercept,
        thickness_mm=number_or_none(facts, tags.SLICE_THICKNESS),
        kernel=text(facts, tags.CONVOLUTION_KERNEL) or text(facts, tags.RECONSTRUCTION_ALGORITHM),
        acquisition=_acquisition(facts, "big" if instance.is_big_endian else "little"),
        phase=_phase(facts, instance.is_big_endian),
        image_type=image_type,
        technique=technique,
        tube_voltage_kv=number_or_none(facts, tags.KVP),
        taken_s=_taken_s(facts),
        stack_id=text(facts, tags.STACK_ID),
    )


def _acquisition(facts: Elements, order: Literal["big", "little"]) -> str:
    """Return what tells acquisitions apart: their number, and which of several times it was."""

    def counted(tag: int) -> str:
        return str(int.from_bytes(facts[tag][:INTEGER_BYTES], order)) if facts.get(tag) else ""

    numbers = text(facts, tags.ACQUISITION_NUMBER), counted(tags.FRAME_ACQUISITION_NUMBER)
    times = text(facts, tags.TEMPORAL_POSITION_IDENTIFIER), counted(tags.TEMPORAL_POSITION_INDEX)
    return " ".join([*filter(None, numbers), *(f"time {one}" for one in times if one)])


def _phase(facts: Elements, big: bool) -> str:
    """Return which part of the heart's cycle an image shows, in percent, as it is told; empty where it is not."""
    raw = facts.get(tags.NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE, b"")
    return f"{struct.unpack('>f' if big else '<f', raw)[0]:g} %" if len(raw) == struct.calcsize("f") else ""


_MOMENT: Final = re.compile(r"(\d{8})?(\d\d)(\d\d)(\d\d(?:\.\d{1,6})?)")


def _taken_s(facts: Elements) -> float | None:
    """Return when an image was acquired, in seconds since any fixed day, None if that is not said."""
    written = (
        text(facts, tags.FRAME_ACQUISITION_DATE_TIME)
        or text(facts, tags.ACQUISITION_DATE_TIME)
        or text(facts, tags.ACQUISITION_DATE) + text(facts, tags.ACQUISITION_TIME)
    )
    found = _MOMENT.match(written)
    if found is None:
        return None
    day = int(found[1] or 0)  # as written: 100 days more each month do no harm to an order
    return ((day * 24 + int(found[2])) * 60 + int(found[3])) * 60 + float(found[4])


def _required(facts: Elements, tag: int, count: int, name: str) -> Vector:
    values = numbers(facts, tag)
    if values is None:
        raise DamagedError(f"its image has no {name}")
    if len(values) != count:
        raise DamagedError(f"its {name} has {len(values)} numbers, expected {count}")
    return values


def _stored_scale(facts: Elements) -> tuple[float, float]:
    """Return slope and intercept of values without a unit: those that are stated, or the stored values as they are."""
    slope, intercept = (number_or_none(facts, tag) for tag in (tags.RESCALE_SLOPE, tags.RESCALE_INTERCEPT))
    stated = (slope if slope else 1.0, intercept or 0.0)
    return stated if max(map(abs, stated)) <= LARGEST_HU else (1.0, 0.0)


def _rescale(facts: Elements) -> tuple[float, float]:
    """Return slope and intercept to HU; refuses values whose unit is another, or unknown."""
    unit = text(facts, tags.RESCALE_TYPE).upper()
    if unit not in _HU_NAMES:
        raise DamagedError(f"its values are in '{unit}', not in Hounsfield units (HU)")
    slope, intercept = numbers(facts, tags.RESCALE_SLOPE), numbers(facts, tags.RESCALE_INTERCEPT)
    if slope is None or intercept is None:
        raise DamagedError("it has no rescale slope and intercept, so its values are not Hounsfield units")
    if len(slope) != 1 or len(intercept) != 1:
        raise DamagedError(
            f"it has {len(slope)} rescale slopes and {len(intercept)} intercepts, expected one each"
        )
    if slope[0] == 0.0 or max(abs(slope[0]), abs(intercept[0])) > LARGEST_HU:
        raise DamagedError(f"its rescale slope {slope[0]} and intercept {intercept[0]} cannot be right")
    return slope[0], intercept[0]


def lacks_a_file(instances: Sequence[Instance]) -> bool:
    """Whether there are some but not all of the files that share the frames of one image."""
    numbers: dict[str, set[int]] = defaultdict(set)
    counts: dict[str, int] = defaultdict(int)
    for one in instances:
        if one.concatenation:
            numbers[one.concatenation].add(one.file_number)
            counts[one.concatenation] = max(counts[one.concatenation], one.file_number, one.file_count)
    return any(len(numbers[image]) < count for image, count in counts.items())
