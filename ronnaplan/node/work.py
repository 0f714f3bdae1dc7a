"""One scan's work, in a process of its own: from the scan to its markers to the objects that answer it.

Beside what `ronnaplan.jobs.serving` tells, ``answer`` is told for each object as soon as it is on the disk.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ronnaplan.errors import RefusedError, RonnaplanError
from ronnaplan.jobs.serving import DONE, Tell, serve
from ronnaplan.node.config import AnswerKind, Rule
from ronnaplan.node.lean import load_pydicom
from ronnaplan.node.papers import KINDS, object_of
from ronnaplan.untrusted import checked

if TYPE_CHECKING:
    from pydicom.dataset import Dataset, FileDataset

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
class Markers:
    """What was found, of whom, in which images."""

    document: FiducialsDocument
    patient: Dataset
    images: list[Path]


def work(order: Order, tell: Tell) -> None:
    """Do a job; raises `RonnaplanError` where the scan or the rule allows no answer."""
    from ronnaplan.documents.files import make_folder

    make_folder(order.output)
    wanted = [kind for kind in order.rule.answers if kind not in order.have]
    papers = _papers(order)
    reason = " and ".join(papers)
    if wanted or not papers:
        reason = _answer_scan(order, wanted, tell)
    for paper, path in papers.items():
        _answer(order, paper, partial(object_of, paper, path, order.folder), tell)
    tell("ended", job=order.job, state=DONE, reason=reason)


def _answer_scan(order: Order, wanted: Sequence[AnswerKind], tell: Tell) -> str:
    """Make the answers of a scan; return what was found.

    What needs the voxels is gathered first, so that they are gone when it is drawn, which takes room of its own.
    """
    volume, fiducials = _find(order)
    load_pydicom()
    from ronnaplan.case.folder import Case
    from ronnaplan.documents.fiducials import fiducials_document
    from ronnaplan.documents.patient import patient_of_scan
    from ronnaplan.report.contact import draw_sheet, gathered
    from ronnaplan.report.quality import drafted

    document = fiducials_document(fiducials)
    patient = patient_of_scan(order.folder, document.source)
    found = Markers(document, patient, sorted(order.folder.glob("*.dcm")))
    if "fiducials" in wanted:
        _answer(order, "fiducials", partial(_fiducials, found), tell)
    sheet, page = None, None
    if "sheet" in wanted:
        with _left_out(order, "sheet", tell):
            sheet = partial(draw_sheet, gathered(volume, fiducials))
    if "pdf" in wanted:
        with _left_out(order, "pdf", tell):
            page = drafted(Case(volume=volume, fiducials=document))
    del volume
    if "sr" in wanted:
        _answer(order, "sr", partial(_sr, found), tell)
    if sheet is not None:
        _answer(order, "sheet", partial(_sheet, found, sheet), tell)
    if page is not None:
        _answer(order, "pdf", partial(_report, found, page), tell)
    return f"{len(fiducials)} markers"


def _papers(order: Order) -> dict[str, Path]:
    """Return the documents of the scan's study that there are."""
    if order.rule.documents is None:
        return {}
    home = order.home / order.rule.documents / order.folder.parent.name
    return {kind: home / name for kind, name in KINDS.items() if (home / name).is_file()}


def _answer(order: Order, kind: str, make: Callable[[], FileDataset], tell: Tell) -> None:
    """Make an object, write it and tell of it."""
    load_pydicom()
    from ronnaplan.documents.dicom_spatial import dicom_bytes
    from ronnaplan.documents.files import write_atomically

    with _left_out(order, kind, tell):
        made = make()
        path = order.output / f"{made.SOPInstanceUID}.dcm"
        write_atomically(path, dicom_bytes(made))
        told = {"sop_uid": made.SOPInstanceUID, "sop_class": made.SOPClassUID, "path": str(path)}
        tell("answer", job=order.job, kind=kind, **told)


@contextmanager
def _left_out(order: Order, kind: str, tell: Tell) -> Iterator[None]:
    """Tell of an answer that cannot be made; it keeps no other one back."""
    try:
        yield
    except RonnaplanError as error:
        tell("left out", job=order.job, answer=kind, reason=str(error))


def _find(order: Order) -> tuple[CTVolume, Fiducials]:
    """Return the scan and its markers; raises `RonnaplanError` where there are none, or another number."""
    from ronnaplan.ct import read_ct
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
    return volume, found


def _fiducials(found: Markers) -> FileDataset:
    from ronnaplan.documents.dicom_spatial import spatial_fiducials

    return spatial_fiducials(found.document, found.patient)


def _sheet(found: Markers, draw: Callable[[], bytes]) -> FileDataset:
    from ronnaplan.documents.dicom_enclosed import secondary_capture

    return secondary_capture(draw(), found.document, found.patient, title="Contact sheet of the markers")


def _sr(found: Markers) -> FileDataset:
    from ronnaplan.node.sr import structured_report

    return structured_report(found.document, found.patient, found.images)


def _report(found: Markers, page: Callable[[], str]) -> FileDataset:
    from ronnaplan.documents.dicom_enclosed import encapsulated_pdf
    from ronnaplan.report.pdf import print_pdf

    return encapsulated_pdf(
        print_pdf(page()), found.document, found.patient, title="Quality report of the markers"
    )


def main(memory_mib: str) -> int:
    """Work until the parent closes this process's standard input, or dies."""

    def obey(given: dict[str, Any], tell: Tell) -> None:
        work(Order.of(given), tell)

    return serve(int(memory_mib), _warm_up, obey)


def _warm_up() -> None:
    """Load what finding markers needs, and the compiled code, before there is a scan."""
    from ronnaplan.jobs.localizing import warm_up

    warm_up()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
