"""One series' work, in a process of its own: from its files to its markers, documents and contact sheet.

Beside what `ronnaplan.jobs.serving` tells, ``part`` is told of each stack that the series falls into.
"""

from __future__ import annotations

import base64
import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ronnaplan import __version__
from ronnaplan.cohort.facts import grid_facts, scan_facts
from ronnaplan.cohort.places import LIMITS, Place
from ronnaplan.cohort.rules import CohortRule
from ronnaplan.errors import InputError, RefusedError, RonnaplanError
from ronnaplan.jobs.serving import DONE, REFUSED, Tell, serve
from ronnaplan.untrusted import checked

if TYPE_CHECKING:
    from ronnaplan.ct import CTVolume, Series
    from ronnaplan.documents.fiducials import FiducialsDocument
    from ronnaplan.localization import Fiducials, Template
    from ronnaplan.registration.phantom_check import KnownPhantom

UNUSABLE, UNCHANGED = "unusable", "unchanged"
"""States of a part beside those of a job: what cannot be read, and what was worked on before."""
GONE = "gone"
"""How an order ends that cannot be worked on now: its files cannot be read, or this program is another version."""


class _GoneError(Exception):
    """A file that was read when it was listed cannot be read now: its disk or a network may be down."""

    def __str__(self) -> str:
        return f"its files cannot be read now; {self.args[0]}"


@dataclass(frozen=True, eq=False)
class _Wanted:
    rule: CohortRule
    template: Template | None
    phantom: KnownPhantom | None


def work(order: dict[str, Any], tell: Tell) -> None:
    """Work on a series; tells of each part, in the order of their keys."""
    from ronnaplan.portable import peak_memory_bytes

    if order["version"] != __version__:
        reason = f"the worker has ronnaplan {__version__}, the command {order['version']}; install the same"
        tell("ended", job=order["job"], state=GONE, reason=reason)
        return
    wanted = _wanted(order)
    try:
        series = _series_of(order)
    except _GoneError as error:
        tell("ended", job=order["job"], state=GONE, reason=str(error))
        return
    for number, one in enumerate(series, start=1):
        told = _part(one, wanted, order["troubled"], order["known"].get(one.key, ""))
        tell("part", job=order["job"], number=number, key=one.key, **told)
    peak = peak_memory_bytes()
    tell("ended", job=order["job"], state=DONE, reason="", peak_bytes=peak)


def _series_of(order: dict[str, Any]) -> list[Series]:
    """Return what the files of an order hold; raises `_GoneError`, and `RefusedError` for files that were changed."""
    from ronnaplan.ct.catalogue import catalogue_of
    from ronnaplan.ct.files import Skipped

    place = Place(order["root"], order["archive"])
    skipped: list[Skipped] = []
    try:
        blobs = place.blobs([(folder, name, size) for folder, name, size in order["files"]], skipped)
    except InputError as error:
        raise _GoneError(error) from error
    listed = catalogue_of(Path(place.archive or place.root), blobs, LIMITS, skipped)
    if listed.skipped:  # headers of all files were read when they were listed
        raise _GoneError(f"{listed.skipped[0].name}: {listed.skipped[0].reason}")
    series = [one for one in listed.series if (one.first.series_uid or "") == order["series_uid"]]
    if not series:
        raise RefusedError("nothing of it is left (its files are of another series now); list its root again")
    if len(blobs) < len(order["files"]) or len(series) < len(listed.series):
        raise _GoneError(
            "some were removed, or are of another series, since they were listed; list its root again"
        )
    return series


def _wanted(order: dict[str, Any]) -> _Wanted:
    from ronnaplan.documents.fiducials import FORMAT, FiducialsDocument
    from ronnaplan.documents.template import TemplateDocument

    rule = checked(order["rule"], CohortRule)
    template = None if order["template"] is None else checked(order["template"], TemplateDocument).template
    truth = order["phantom"]
    if truth is None:
        return _Wanted(rule, template, None)
    from ronnaplan.documents.phantom_check import known_phantom  # which takes as long to load as all else

    is_scan = truth["format"] == FORMAT
    document = checked(truth, FiducialsDocument) if is_scan else checked(truth, TemplateDocument)
    return _Wanted(rule, template, known_phantom(document, rule.phantom or ""))


def _part(series: Series, wanted: _Wanted, troubled: bool, known: str) -> dict[str, Any]:
    """Return what is told of a part; ``known`` is the content that there are results of already."""
    from ronnaplan.ct.reader import read_series
    from ronnaplan.ct.volume import VolumeFlag

    told: dict[str, Any] = {"state": UNUSABLE, "reason": "; ".join(series.problems), "scan": scan_facts(series)}
    told["content"] = _content(series, "")
    if not series.is_usable:
        return told
    try:
        volume = read_series(series, beside=(VolumeFlag.UNREADABLE_FILES,) if troubled else ())
        told["content"] = _content(series, volume.voxel_sha256)
        if told["content"] == known:
            return {**told, "state": UNCHANGED}
        told["scan"].update(grid_facts(volume))
        return {**told, **_localized(volume, wanted)}
    except RonnaplanError as error:
        if isinstance(error.__cause__, MemoryError):  # nothing is wrong with the series: it is set aside
            raise MemoryError(str(error)) from error
        state = REFUSED if isinstance(error, RefusedError) else UNUSABLE
        return {**told, "state": state, "reason": str(error)}


def _localized(volume: CTVolume, wanted: _Wanted) -> dict[str, Any]:
    """Find the markers; a wrong number, or a phantom that does not pair, is refused with all that was found."""
    from ronnaplan.documents.fiducials import fiducials_document
    from ronnaplan.documents.reading import to_json
    from ronnaplan.jobs.localizing import find_markers
    from ronnaplan.localization.localizer import require_count

    found, warnings = find_markers(volume, wanted.rule, wanted.template)
    document = fiducials_document(found)
    told: dict[str, Any] = {
        "state": DONE,
        "reason": "; ".join(warnings),
        "found": len(found),
        "expected": wanted.rule.expected,
        "markers": _markers(document),
        "rejected": [one.test for one in found.rejected],
        "fiducials": to_json(document),
        "sheet": _sheet(volume, found) if wanted.rule.sheet else None,
    }
    try:
        require_count(found, wanted.rule.expected)
        if wanted.phantom is not None:
            told["checked"] = _checked(volume, found, wanted.phantom)
    except RonnaplanError as error:
        told |= {"state": REFUSED, "reason": str(error)}
    return told


def _markers(document: FiducialsDocument) -> list[dict[str, Any]]:
    return [one.model_dump(mode="json", exclude={"bound"}) for one in document.fiducials]


def _sheet(volume: CTVolume, found: Fiducials) -> str:
    from ronnaplan.report.contact import contact_sheet

    return base64.b64encode(contact_sheet(volume, found)).decode()


def _checked(volume: CTVolume, found: Fiducials, phantom: KnownPhantom) -> dict[str, Any]:
    """Compare with a known phantom: mean and RMS error of the distances between its markers, scales, why it fails."""
    import numpy as np
    from scipy.spatial.distance import pdist

    from ronnaplan.registration.phantom_check import check_phantom, names_of_scan
    from ronnaplan.registration.phantom_verdict import reasons_against

    scan = names_of_scan(volume.voxel_sha256, volume.source.series_instance_uid)
    check = check_phantom(phantom, found.points, volume.grid.axes, scan)
    fit = check.registration
    errors_mm = pdist(fit.fixed_mm) - pdist(fit.moving_mm)
    return {
        "phantom": phantom.name,
        "distance_mean_mm": float(errors_mm.mean()),
        "distance_rms_mm": float(np.sqrt(np.mean(errors_mm**2))),
        "in_slices_rms_mm": check.in_slices_rms_mm,
        "across_rms_mm": check.across_rms_mm,
        "stretches": {one.name: one.share for one in check.stretches},
        "reasons": list(reasons_against(check)),
    }


def _content(series: Series, voxels_sha256: str) -> str:
    """Return what tells a part from any other: all elements that the reader looks at, and the voxels."""
    digest = hashlib.sha256(f"{series.key} {series.file_count} {voxels_sha256}".encode())
    instances = [series.first] if series.stack is None else [one.instance for one in series.stack.slices]
    for instance in instances:
        digest.update(repr(sorted(instance.elements.items())).encode())
    return digest.hexdigest()


def _warm_up() -> None:
    """Load what a series needs, and the compiled code, before there is one."""
    import ronnaplan.documents.fiducials
    import ronnaplan.documents.template
    import ronnaplan.report.contact  # noqa: F401
    from ronnaplan.jobs.localizing import warm_up

    warm_up()


def main(memory_mib: str) -> int:
    """Work until the parent closes this process's standard input, or dies."""
    return serve(int(memory_mib), _warm_up, work)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
