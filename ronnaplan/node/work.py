"""One scan's work, in a process of its own: from the scan to its markers to the objects that answer it.

Beside what `ronnaplan.jobs.serving` tells, ``answer`` is told for each object as soon as it is on the disk.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ronnaplan.errors import RefusedError, RonnaplanError, UnwrittenError
from ronnaplan.jobs.serving import DONE, Tell, serve
from ronnaplan.node.config import AnswerKind, Rule
from ronnaplan.node.lean import load_pydicom
from ronnaplan.node.papers import KINDS, object_of
from ronnaplan.portable import run_instead
from ronnaplan.text import counted
from ronnaplan.untrusted import checked

if TYPE_CHECKING:
    from pydicom.dataset import Dataset, FileDataset

    from ronnaplan.ct import CTVolume
    from ronnaplan.ct.scratch import Scratch
    from ronnaplan.documents.fiducials import FiducialsDocument
    from ronnaplan.localization import Fiducials


MODULE: Final = "ronnaplan.node.work"


@dataclass(frozen=True)
class Order:
    """A job: the ``instances`` in ``folder``, what is to be done with them, and the answers that there are already."""

    job: int
    folder: Path
    instances: int
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
        rule, have = checked(given["rule"], Rule), tuple(given["have"])
        return cls(given["job"], folder, given["instances"], home, output, rule, have)

    @property
    def text(self) -> str:
        """The order as a line."""
        paths = {"folder": str(self.folder), "home": str(self.home), "output": str(self.output)}
        known = {"job": self.job, "instances": self.instances, **paths}
        return json.dumps({**known, "rule": self.rule.model_dump(mode="json"), "have": self.have})


@dataclass(frozen=True, eq=False)
class Markers:
    """What was found, of whom, in which images."""

    document: FiducialsDocument
    patient: Dataset
    images: list[Path]


@dataclass(frozen=True, eq=False)
class Begun:
    """A job whose voxels are no longer needed: what is to be made by whom, and what was found."""

    order: Order
    makers: dict[str, Callable[..., FileDataset]]
    """Those of `papers.KINDS` are given what to tell of values that are left empty."""
    reason: str


def begin(order: Order, tell: Tell) -> Begun:
    """Do what of a job needs the voxels, and make the first answer; `finish` does the rest.

    What the others need of the scan is gathered, so that it is gone when they are drawn, which takes room of its own.
    Raises `RefusedError` where files are gone that were received, `UnwrittenError` where all that the node keeps is.
    """
    images = _images_of(order)
    try:
        return _begun(order, images, tell)
    except RonnaplanError:
        _images_of(order)  # what went while it was read is the reason
        raise


def _images_of(order: Order) -> list[Path]:
    """Return all files of an order; raises as `begin` does."""
    images = sorted(order.folder.glob("*.dcm"))
    gone = order.instances - len(images)
    if gone > 0 and not (kept := order.folder.parents[1]).is_dir():
        raise UnwrittenError(f"the node's folder {kept} is not there; see to its disk")
    if gone > 0:
        raise RefusedError(
            f"{gone} of its {order.instances} files are gone from the node's folder; send it again, then retry"
        )
    return images


def _begun(order: Order, images: list[Path], tell: Tell) -> Begun:
    from ronnaplan.ct.scratch import Scratch
    from ronnaplan.documents.files import make_folder

    make_folder(order.output)
    wanted = [kind for kind in order.rule.answers if kind not in order.have]
    papers = _papers(order)
    reason = " and ".join(papers)
    makers: dict[str, Callable[[], FileDataset]] = {}
    if wanted or not papers:
        with Scratch(order.output) as scratch:
            reason, makers = _gather(order, images, wanted, tell, scratch)
    made_of = {paper: partial(object_of, paper, path, order.folder) for paper, path in papers.items()}
    return Begun(order, makers | made_of, reason)


def finish(begun: Begun, tell: Tell, give_way: Callable[[Begun], None]) -> None:
    """Make the other answers, of which each lets go of what it shows, and tell that it is done.

    ``give_way``, called between them, may have another program finish it.
    """
    for kind in tuple(begun.makers):
        make = begun.makers.pop(kind)
        is_paper = kind in KINDS
        _answer(begun.order, kind, partial(make, _left_empty(begun.order, tell)) if is_paper else make, tell)
        if begun.makers:
            give_way(begun)
    tell("ended", job=begun.order.job, state=DONE, reason=begun.reason)


def _gather(
    order: Order, images: list[Path], wanted: Sequence[AnswerKind], tell: Tell, scratch: Scratch
) -> tuple[str, dict[str, Callable[[], FileDataset]]]:
    """Return what was found, and what makes the answers but for the first, which is made at once."""
    volume, fiducials, warnings = _find(order, scratch)
    load_pydicom()
    from ronnaplan.documents.fiducials import fiducials_document
    from ronnaplan.node.received import patient_received

    document = fiducials_document(fiducials)
    patient = patient_received(order.folder, document.source, _left_empty(order, tell))
    found = Markers(document, patient, images)
    if "fiducials" in wanted:
        _answer(order, "fiducials", partial(_fiducials, found), tell)
    from ronnaplan.case.folder import Case
    from ronnaplan.report.contact import draw_sheet, gathered
    from ronnaplan.report.quality import drafted

    makers: dict[str, Callable[[], FileDataset]] = {"sr": partial(_sr, found)} if "sr" in wanted else {}
    if "sheet" in wanted:
        with _left_out(order, "sheet", tell):
            makers["sheet"] = partial(_sheet, partial(draw_sheet, gathered(volume, fiducials)), found)
    if "pdf" in wanted:
        with _left_out(order, "pdf", tell):
            makers["pdf"] = partial(_report, drafted(Case(volume=volume, fiducials=document)), found, order.output)
    return "; ".join([counted(len(fiducials), "marker"), *volume.flags, *warnings]), makers


def _papers(order: Order) -> dict[str, Path]:
    """Return the documents of the scan's study that there are."""
    if order.rule.documents is None:
        return {}
    home = order.home / order.rule.documents / order.folder.parent.name
    with suppress(OSError):  # who looks for them tells of it
        return {kind: home / name for kind, name in KINDS.items() if (home / name).is_file()}
    return {}


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


def _left_empty(order: Order, tell: Tell) -> Callable[[str], None]:
    """Return what tells of a value of patient or study that DICOM does not know."""
    return lambda reason: tell("left empty", job=order.job, reason=reason)


@contextmanager
def _left_out(order: Order, kind: str, tell: Tell) -> Iterator[None]:
    """Tell of an answer that cannot be made; it keeps no other one back, but where nothing can be written now."""
    try:
        yield
    except UnwrittenError:
        raise
    except RonnaplanError as error:
        tell("left out", job=order.job, answer=kind, reason=str(error))


def _find(order: Order, scratch: Scratch) -> tuple[CTVolume, Fiducials, tuple[str, ...]]:
    """Return scan, markers and warnings of these; raises `RonnaplanError` where there are none, or another number."""
    from ronnaplan.documents.template import read_template
    from ronnaplan.jobs.localizing import find_markers
    from ronnaplan.localization.localizer import require_count
    from ronnaplan.node.received import read_received

    rule = order.rule
    volume = read_received(order.folder, scratch)
    template = None if rule.template is None else read_template(order.home / rule.template)
    found, warnings = find_markers(volume, rule, template)
    require_count(found, rule.expected)
    if not len(found):
        raise RefusedError(f"no marker was found; {counted(len(found.rejected), 'candidate')} rejected")
    return volume, found, warnings


def _fiducials(found: Markers) -> FileDataset:
    from ronnaplan.documents.dicom_spatial import spatial_fiducials

    return spatial_fiducials(found.document, found.patient)


def _sheet(draw: Callable[[], bytes], found: Markers) -> FileDataset:
    from ronnaplan.documents.dicom_enclosed import secondary_capture

    return secondary_capture(draw(), found.document, found.patient, title="Contact sheet of the markers")


def _sr(found: Markers) -> FileDataset:
    from ronnaplan.node.sr import structured_report

    return structured_report(found.document, found.patient, found.images)


def _report(page: Callable[[], str], found: Markers, below: Path) -> FileDataset:
    from ronnaplan.documents.dicom_enclosed import encapsulated_pdf
    from ronnaplan.report.pdf import print_pdf

    # Below the answers, where what a killed worker leaves is removed: it tells of a patient.
    printed = print_pdf(page(), below)
    return encapsulated_pdf(printed, found.document, found.patient, title="Quality report of the markers")


def main(memory_mib: str, begun: str = "") -> int:
    """Work until the parent closes this process's standard input, or dies; first finish what is ``begun``, if any.

    That is the number of an open file. What finds markers takes a hundred megabytes, and what makes each of the answers
    as many: so the one gives way to the other.
    """

    def give_way(half: Begun) -> None:
        with tempfile.TemporaryFile(dir=half.order.output) as file:
            pickle.dump(half, file)
            file.flush()
            file.seek(0)
            arguments = [sys.executable, "-m", MODULE, memory_mib, str(file.fileno())]
            run_instead(arguments, keep=file.fileno())

    def obey(given: dict[str, Any], tell: Tell) -> None:
        half = begin(Order.of(given), tell)
        give_way(half)
        finish(half, tell, give_way)

    if not begun:
        return serve(int(memory_mib), _warm_up, obey)
    import numpy as np  # noqa: F401  # before pydicom, which looks for it

    load_pydicom()
    with os.fdopen(int(begun), "rb") as file:
        half: Begun = pickle.load(file)  # that was written above
    return serve(
        int(memory_mib),
        lambda: None,
        lambda _, tell: finish(half, tell, give_way),
        begun={"job": half.order.job},
    )


def _warm_up() -> None:
    """Load what finding markers needs, and the compiled code, before there is a scan."""
    from ronnaplan.jobs.localizing import warm_up

    warm_up()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
