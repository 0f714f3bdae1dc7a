"""One scan's work, in a process of its own: from the scan to its markers to the objects that answer it.

Beside what `ronnaplan.jobs.serving` tells, ``answer`` is told for each object as soon as it is on the disk.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ronnaplan.errors import RefusedError, RonnaplanError
from ronnaplan.jobs.serving import DONE, Tell, serve
from ronnaplan.node.config import Rule
from ronnaplan.node.papers import KINDS, object_of
from ronnaplan.untrusted import checked

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

    from ronnaplan.ct import CTVolume
    from ronnaplan.documents.fiducials import FiducialsDocument
    from ronnaplan.localization import Fiducials


@dataclass(frozen=True)
class Order:
    """A job: the scan in ``folder``, what is to be done with it, and the answers that there are already."""

    job: int
    folder: Path
    home: Path
    output: Path
    rule: Rule
    have: tuple[str, ...]

    @classmethod
    def parse(cls, line: str) -> Order:
        """Read the line that `text` wrote."""
        return cls.of(json.loads(line))

    @classmethod
    def of(cls, given: dict[str, Any]) -> Order:
        """Return the order that came as an object."""
        folder, home, output = (Path(given[name]) for name in ("folder", "home", "output"))
        return cls(given["job"], folder, home, output, checked(given["rule"], Rule), tuple(given["have"]))

    @property
    def text(self) -> str:
        """The order as a line."""
        paths = {"folder": str(self.folder), "home": str(self.home), "output": str(self.output)}
        return json.dumps({"job": self.job, **paths, "rule": self.rule.model_dump(mode="json"), "have": self.have})


@dataclass(frozen=True, eq=False)
class Found:
    """What answers are made of."""

    images: list[Path]
    volume: CTVolume
    fiducials: Fiducials
    document: FiducialsDocument
    patient: Dataset


def work(order: Order, tell: Tell) -> None:
    """Do a job; raises `RonnaplanError` where the scan or the rule allows no answer."""
    from ronnaplan.documents.files import make_folder

    make_folder(order.output)
    wanted = [kind for kind in order.rule.answers if kind not in order.have]
    papers = _papers(order)
    reason = " and ".join(papers)
    if wanted or not papers:
        found = _find(order)
        reason = f"{len(found.fiducials)} markers"
        for kind in wanted:
            _answer(order, kind, partial(ANSWERS[kind], found), tell)
    for paper, path in papers.items():
        _answer(order, paper, partial(object_of, paper, path, order.folder), tell)
    tell("ended", job=order.job, state=DONE, reason=reason)


def _papers(order: Order) -> dict[str, Path]:
    """Return the documents of the scan's study that there are."""
    if order.rule.documents is None:
        return {}
    home = order.home / order.rule.documents / order.folder.parent.name
    return {kind: home / name for kind, name in KINDS.items() if (home / name).is_file()}


def _answer(order: Order, kind: str, make: Callable[[], Any], tell: Tell) -> None:
    """Make an object, write it and tell of it; one that cannot be made keeps no other one back."""
    from ronnaplan.documents.dicom_spatial import dicom_bytes
    from ronnaplan.documents.files import write_atomically

    try:
        made = make()
    except RonnaplanError as error:
        tell("left out", job=order.job, answer=kind, reason=str(error))
        return
    path = order.output / f"{made.SOPInstanceUID}.dcm"
    write_atomically(path, dicom_bytes(made))
    told = {"sop_uid": made.SOPInstanceUID, "sop_class": made.SOPClassUID, "path": str(path)}
    tell("answer", job=order.job, kind=kind, **told)


def _find(order: Order) -> Found:
    from ronnaplan.ct import read_ct
    from ronnaplan.documents.fiducials import fiducials_document
    from ronnaplan.documents.patient import patient_of_scan
    from ronnaplan.documents.template import read_template
    from ronnaplan.jobs.localizing import find_markers
    from ronnaplan.localization import require_count

    rule = order.rule
    volume = read_ct(order.folder)
    template = None if rule.template is None else read_template(order.home / rule.template)
    found = find_markers(volume, rule, template)
    require_count(found, rule.expected)
    if not len(found):
        raise RefusedError(f"no marker was found; {len(found.rejected)} candidates were rejected")
    document = fiducials_document(found)
    patient = patient_of_scan(order.folder, document.source)
    return Found(sorted(order.folder.glob("*.dcm")), volume, found, document, patient)


def _fiducials(found: Found) -> Any:
    from ronnaplan.documents.dicom_spatial import spatial_fiducials

    return spatial_fiducials(found.document, found.patient)


def _report(found: Found) -> Any:
    from ronnaplan.case.folder import Case
    from ronnaplan.documents.dicom_enclosed import encapsulated_pdf
    from ronnaplan.report.pdf import print_pdf
    from ronnaplan.report.quality import quality_report

    page = quality_report(Case(volume=found.volume, fiducials=found.document))
    return encapsulated_pdf(print_pdf(page), found.document, found.patient, title="Quality report of the markers")


def _sheet(found: Found) -> Any:
    from ronnaplan.documents.dicom_enclosed import secondary_capture
    from ronnaplan.report.contact import contact_sheet

    picture = contact_sheet(found.volume, found.fiducials)
    return secondary_capture(picture, found.document, found.patient, title="Contact sheet of the markers")


def _sr(found: Found) -> Any:
    from ronnaplan.node.sr import structured_report

    return structured_report(found.document, found.images)


ANSWERS: dict[str, Callable[[Found], Any]] = {"fiducials": _fiducials, "sr": _sr, "pdf": _report, "sheet": _sheet}
"""What makes each kind of answer."""


def main(memory_mib: str) -> int:
    """Work until the parent closes this process's standard input, or dies."""

    def obey(given: dict[str, Any], tell: Tell) -> None:
        work(Order.of(given), tell)

    return serve(int(memory_mib), _warm_up, obey)


def _warm_up() -> None:
    """Load what a job needs, and the compiled code, before there is one: answer a scan of one ball."""
    import ronnaplan.documents.dicom_enclosed
    import ronnaplan.documents.dicom_spatial
    import ronnaplan.documents.patient  # noqa: F401
    from ronnaplan.case.folder import Case
    from ronnaplan.documents.fiducials import fiducials_document
    from ronnaplan.jobs.localizing import warm_up
    from ronnaplan.node import sr
    from ronnaplan.report.contact import contact_sheet
    from ronnaplan.report.quality import quality_report

    volume, fiducials = warm_up()
    document = fiducials_document(fiducials)
    contact_sheet(volume, fiducials)
    quality_report(Case(volume=volume, fiducials=document))
    sr.warm_up(document)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
