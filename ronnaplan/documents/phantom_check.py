"""phantom-check.json: what scans of a known phantom say of a scanner; and the files that say how it is made."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ronnaplan.documents.fiducials import FORMAT as FIDUCIALS
from ronnaplan.documents.fiducials import FiducialsDocument, Resolution, Source, read_fiducials
from ronnaplan.documents.fields import (
    DocumentModel,
    Label,
    LengthMm,
    Line,
    PositiveMm,
    Probability,
    Ratio,
    Software,
)
from ronnaplan.documents.files import read_json
from ronnaplan.documents.reading import made, validated
from ronnaplan.documents.template import FORMAT as TEMPLATE
from ronnaplan.documents.template import TemplateDocument, read_template_document
from ronnaplan.errors import InputError
from ronnaplan.localization import Fiducials
from ronnaplan.localization.advice import Advice
from ronnaplan.registration.phantom_check import KnownPhantom, PhantomCheck, names_of_scan
from ronnaplan.registration.phantom_verdict import Estimate, normalized_error, share_within
from ronnaplan.text import printable

SIMULATED = "phantoms.truth"
"""The format of what `ronnaplan phantom` writes beside a scan."""


@dataclass(frozen=True, eq=False)
class CheckedScan:
    """A scan of the phantom, judged: its markers, the check, why it does not pass, and what to change."""

    path: str
    found: Fiducials
    check: PhantomCheck
    reasons: tuple[str, ...]
    advice: tuple[Advice, ...]


class EstimateEntry(DocumentModel):
    """A figure with its 95 % interval."""

    value: Ratio
    low: Ratio
    high: Ratio


class StretchEntry(DocumentModel):
    """How far the scan is stretched, or its slices slide along u or v: the share of a length."""

    name: Label
    share: float
    standard_error: Ratio
    is_sure: bool


class MarkerEntry(DocumentModel):
    """A marker of the phantom: how far from its place it was found, along u, v (in the slices) and w (across)."""

    label: Label
    error: tuple[float, float, float]


class AdviceEntry(DocumentModel):
    """A setting, as it was found and as it had better be."""

    setting: Label
    found: Line
    advised: Line
    reason: Line


class ScanEntry(DocumentModel):
    """One scan of the phantom."""

    path: Line
    source: Source
    passed: bool
    reasons: tuple[Line, ...]
    markers: tuple[MarkerEntry, ...]
    missing: tuple[Label, ...]
    strange: tuple[Label, ...]
    mean_error_mm: LengthMm
    worst_error_mm: LengthMm
    in_slices_rms_mm: LengthMm
    across_rms_mm: LengthMm
    normalized_error: EstimateEntry
    within_95: EstimateEntry
    stretches: tuple[StretchEntry, ...]
    resolution: Resolution | None
    settings: tuple[AdviceEntry, ...]


class PhantomEntry(DocumentModel):
    """The phantom."""

    name: Label
    markers: int
    has_hand: bool


class PhantomCheckDocument(DocumentModel):
    """The whole of phantom-check.json, version 1; ``together`` sums up the scans."""

    format: Literal["ronnaplan.phantom-check"]
    version: Literal[1]
    unit: Literal["mm"]
    phantom: PhantomEntry
    diameter_mm: PositiveMm
    probability: Probability = 0.95
    scans: tuple[ScanEntry, ...]
    normalized_error: EstimateEntry
    within_95: EstimateEntry
    software: Software


def read_known_phantom(path: str | os.PathLike[str], sigma_mm: float | None) -> KnownPhantom:
    """Read a template, a fiducials.json, or a simulated scan's truth.json, as the truth about a phantom.

    ``sigma_mm`` is the error of its places per axis; without it a template is exact and a fiducials.json as sure as
    it says. Raises `InputError` for anything else.
    """
    return known_phantom(read_truth(path), Path(path).name, sigma_mm)


def read_truth(path: str | os.PathLike[str]) -> FiducialsDocument | TemplateDocument:
    """Read what says where a phantom's markers are; raises `InputError` for anything else."""
    content = read_json(path)
    told = content.get("format") if isinstance(content, dict) else None
    if told == FIDUCIALS:
        return read_fiducials(path)
    if told == SIMULATED:
        return _simulated(content, os.fspath(path))
    if told != TEMPLATE:
        raise InputError(
            f"{os.fspath(path)} is no template ('{TEMPLATE}'), fiducials.json or truth.json of a simulated scan; write "
            "a template with the markers' labels, and their centers or distances"
        )
    return read_template_document(path)


def _simulated(content: dict[str, Any], name: str) -> TemplateDocument:
    """Return the markers of a simulated scan, at their places in it, as a template."""
    markers = content.get("markers")
    if not isinstance(markers, list) or not all(isinstance(one, dict) for one in markers):
        raise InputError(f"{name} lists no markers; give the truth.json that 'ronnaplan phantom' wrote")
    moved = [printable(one.get("label")) for one in markers if "path" in one]
    if moved:
        raise InputError(f"in {name} {moved[0]} moved during the scan; a phantom rests, so simulate one that does")
    if content.get("coordinate_system") != "LPS":
        raise InputError(f"{name} is in {printable(content.get('coordinate_system'))}; expected LPS")
    template = {
        "format": TEMPLATE,
        "version": content.get("version"),
        "unit": content.get("unit"),
        "name": content.get("scene"),
        "labels": [one.get("label") for one in markers],
        "centers": [one.get("center") for one in markers],
    }
    return validated(template, TemplateDocument, name, "give the truth.json that 'ronnaplan phantom' wrote")


def known_phantom(
    truth: FiducialsDocument | TemplateDocument, name: str, sigma_mm: float | None = None
) -> KnownPhantom:
    """Return the phantom that ``truth`` describes, called ``name`` unless it says so; ``sigma_mm`` as above."""
    if isinstance(truth, TemplateDocument):
        return KnownPhantom.of(
            truth.name, truth.labels, truth.centers_mm, sigma_mm or 0.0, has_hand=bool(truth.centers)
        )
    points, source = truth.points, truth.source
    scan = names_of_scan(source.voxel_sha256, source.series_instance_uid)
    if sigma_mm is None:
        return KnownPhantom(name, points.labels, points.positions_mm, points.covariances_mm2, scan=scan)
    return KnownPhantom.of(name, points.labels, points.positions_mm, sigma_mm, scan=scan)


def phantom_check_document(phantom: KnownPhantom, scans: list[CheckedScan]) -> PhantomCheckDocument:
    """Put the scans of one phantom together as a document."""
    return made(
        PhantomCheckDocument,
        {
            "phantom": {"name": phantom.name, "markers": len(phantom.labels), "has_hand": phantom.has_hand},
            "diameter_mm": scans[0].found.diameters_mm[0],
            "scans": [_scan(one) for one in scans],
            "normalized_error": _estimate(normalized_error([one.check.judged for one in scans])),
            "within_95": _estimate(share_within([one.check.within for one in scans])),
        },
    )


def _scan(one: CheckedScan) -> dict[str, object]:
    from ronnaplan.documents.fiducials import fiducials_document

    document, check = fiducials_document(one.found), one.check
    lengths = np.linalg.norm(check.errors_mm, axis=1)
    return {
        "path": one.path,
        "source": document.source,
        "passed": not one.reasons,
        "reasons": one.reasons,
        "markers": [
            {"label": label, "error": error.tolist()}
            for label, error in zip(check.registration.labels, check.errors_mm, strict=True)
        ],
        "missing": check.missing,
        "strange": check.strange,
        "mean_error_mm": float(lengths.mean()),
        "worst_error_mm": float(lengths.max()),
        "in_slices_rms_mm": check.in_slices_rms_mm,
        "across_rms_mm": check.across_rms_mm,
        "normalized_error": _estimate(normalized_error([check.judged])),
        "within_95": _estimate(share_within([check.within])),
        "stretches": [asdict(stretch) for stretch in check.stretches],
        "resolution": document.resolution,
        "settings": [asdict(advice) for advice in one.advice],
    }


def _estimate(one: Estimate) -> dict[str, float]:
    return asdict(one)
