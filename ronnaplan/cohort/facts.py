"""What a series' header says of how and with what it was taken: for rules, and for the tables."""

from __future__ import annotations

import re
from typing import Any, Final

from ronnaplan.ct import tags
from ronnaplan.ct.catalogue import Series
from ronnaplan.ct.header import Elements
from ronnaplan.ct.slices import Instance
from ronnaplan.ct.values import number_or_none, text
from ronnaplan.ct.volume import CTVolume

TIME: Final = re.compile(r"([0-9]{2})([0-9]{2})([0-9]{2}(?:\.[0-9]{1,6})?)")


def rule_texts(instance: Instance, folder: str) -> tuple[str, ...]:
    """Return what rules look at, in the order of `ronnaplan.cohort.index.TEXTS`."""
    elements = instance.elements
    return (
        instance.modality,
        instance.description,
        text(elements, tags.PROTOCOL_NAME),
        text(elements, tags.STATION_NAME),
        text(elements, tags.STUDY_DESCRIPTION),
        device_name(elements),
        folder,
    )


def device_name(elements: Elements) -> str:
    """Return maker, model and serial number, as far as they are told."""
    given = (tags.MANUFACTURER, tags.MANUFACTURER_MODEL_NAME, tags.DEVICE_SERIAL_NUMBER)
    return " ".join(part for part in (text(elements, tag) for tag in given) if part)


def scan_facts(series: Series) -> dict[str, Any]:
    """Return what the tables tell of a series; nothing names the patient. What is not told is None."""
    first = series.first
    elements = first.elements
    given = {
        "modality": first.modality,
        "description": first.description,
        "protocol": text(elements, tags.PROTOCOL_NAME),
        "manufacturer": text(elements, tags.MANUFACTURER),
        "model": text(elements, tags.MANUFACTURER_MODEL_NAME),
        "serial": text(elements, tags.DEVICE_SERIAL_NUMBER),
        "station": text(elements, tags.STATION_NAME),
        "scanner_software": text(elements, tags.SOFTWARE_VERSIONS),
        "kernel": series.kernel,
        "acquired": _day(elements),
        "acquired_time": _time(elements),
    }
    return {
        **{name: value or None for name, value in given.items()},
        "kilovolts": number_or_none(elements, tags.KVP),
        "exposure_mas": number_or_none(elements, tags.EXPOSURE),
        "ctdi_vol_mgy": _double(elements, first.is_big_endian),
        "slices": series.image_count,
        "scan_flags": [] if series.stack is None else [flag.name.lower() for flag in series.stack.flags],
    }


def grid_facts(volume: CTVolume) -> dict[str, Any]:
    """Return the voxels' sizes (mm), the tilt (degrees) and the flags of a scan that was read."""
    grid = volume.grid
    return {
        "rows": volume.voxels_hu.shape[1],
        "columns": volume.voxels_hu.shape[2],
        "thickness_mm": grid.thickness_mm,
        "spacing_mm": grid.typical_gap_mm,
        "pixel_mm": grid.row_spacing_mm,
        "tilt_deg": grid.tilt_deg,
        "scan_flags": [flag.name.lower() for flag in volume.flags],
    }


def _day(elements: Elements) -> str:
    """Return the day of the acquisition, or of the study, as 2026-01-31."""
    for tag in (tags.ACQUISITION_DATE, tags.ACQUISITION_DATE_TIME, tags.STUDY_DATE):
        day = text(elements, tag)[:8]
        if len(day) == 8 and day.isascii() and day.isdigit():
            return f"{day[:4]}-{day[4:6]}-{day[6:]}"
    return ""


def _time(elements: Elements) -> str:
    """Return the time of day of the acquisition, as 07:05:30 or 07:05:30.25; that of the study is another."""
    at_once = text(elements, tags.ACQUISITION_DATE_TIME)[8:]
    told = TIME.match(text(elements, tags.ACQUISITION_TIME) if elements.get(tags.ACQUISITION_DATE) else at_once)
    return ":".join(told.groups()) if told else ""


def _double(elements: Elements, big: bool) -> float | None:
    """Return CTDIvol, which is written as eight bytes, unlike the other numbers."""
    import math
    import struct

    raw = elements.get(tags.CTDI_VOL, b"")
    if not isinstance(raw, bytes) or len(raw) != 8:
        return None
    value: float = struct.unpack(">d" if big else "<d", raw)[0]
    return value if math.isfinite(value) else None
