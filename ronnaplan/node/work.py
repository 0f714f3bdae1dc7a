"""One scan's work, in a process of its own: from the scan to its markers to the objects that answer it.

Orders come as JSON, one a line of standard input; what was done is told the same way: ``answer`` for each object as
soon as it is on the disk, ``ended`` when there is no more.
"""

from __future__ import annotations

import json
import queue
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ronnaplan.errors import InputError, RefusedError, RonnaplanError
from ronnaplan.node.config import Rule
from ronnaplan.node.processes import end_with_parent
from ronnaplan.untrusted import checked

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

    from ronnaplan.ct import CTVolume
    from ronnaplan.documents.fiducials import FiducialsDocument
    from ronnaplan.localization import Fiducials

MIB = 1 << 20
DONE, REFUSED, BROKEN = "done", "refused", "broken"
"""How a job ends: with answers, with a reason that no second attempt would change, or by a fault."""


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
        given = json.loads(line)
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


def work(order: Order, tell: Callable[..., None]) -> None:
    """Do a job; raises `RonnaplanError` where the scan or the rule allows no answer."""
    from ronnaplan.documents.dicom_spatial import dicom_bytes
    from ronnaplan.documents.files import make_folder, write_atomically

    wanted = [kind for kind in order.rule.answers if kind not in order.have]
    found = _find(order)
    make_folder(order.output)
    for kind in wanted:
        try:
            made = ANSWERS[kind](found)
        except InputError as error:  # one answer that cannot be made keeps no other one back
            tell("left out", job=order.job, answer=kind, reason=str(error))
            continue
        path = order.output / f"{made.SOPInstanceUID}.dcm"
        write_atomically(path, dicom_bytes(made))
        tell(
            "answer",
            job=order.job,
            kind=kind,
            sop_uid=made.SOPInstanceUID,
            sop_class=made.SOPClassUID,
            path=str(path),
        )
    tell("ended", job=order.job, state=DONE, reason=f"{len(found.fiducials)} markers")


def _find(order: Order) -> Found:
    from ronnaplan.ct import read_ct
    from ronnaplan.documents.fiducials import fiducials_document
    from ronnaplan.documents.patient import patient_of_scan
    from ronnaplan.documents.template import read_template
    from ronnaplan.localization import Build, common_diameter, localize

    rule = order.rule
    volume = read_ct(order.folder)
    found = localize(
        volume,
        diameter_mm=rule.diameters or common_diameter(volume),
        expected=rule.expected,
        template=None if rule.template is None else read_template(order.home / rule.template),
        marker=Build.parse(rule.marker),
    )
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
    from ronnaplan.portable import limit_memory

    orders: queue.SimpleQueue[str] = queue.SimpleQueue()
    output, sys.stdout = sys.stdout, sys.stderr  # what a library prints is no answer

    def tell(event: str, **facts: Any) -> None:
        print(json.dumps({"event": event, **facts}), file=output, flush=True)

    threading.Thread(target=_serve, args=(orders, tell), daemon=True).start()
    limit_memory(int(memory_mib) * MIB)
    end_with_parent(orders.put)
    return 0


def _serve(orders: queue.SimpleQueue[str], tell: Callable[..., None]) -> None:
    _warm_up()
    tell("ready")
    while True:
        order = Order.parse(orders.get())
        try:
            work(order, tell)
        except RonnaplanError as error:
            tell("ended", job=order.job, state=REFUSED, reason=str(error))
        except Exception as error:  # whatever it is, it is this job's: told, and tried again
            tell("ended", job=order.job, state=BROKEN, reason=f"{type(error).__name__}: {error}")


def _warm_up() -> None:
    """Load what a job needs, and the compiled code, before there is one."""
    from contextlib import suppress

    import numpy as np

    import ronnaplan.case.folder
    import ronnaplan.documents.patient
    import ronnaplan.node.sr  # noqa: F401
    from ronnaplan.ct import CTVolume, SeriesSource
    from ronnaplan.ct.volume import SliceGrid
    from ronnaplan.localization import localize

    places = np.arange(24.0)
    i, j, k = np.meshgrid(places, places, places, indexing="ij")
    ball = np.where((i - 12) ** 2 + (j - 12) ** 2 + (k - 12) ** 2 < 5.75**2, 100, -1000).astype(np.int16)
    origins = np.stack([np.zeros(24), np.zeros(24), places], axis=1)
    with suppress(RonnaplanError):
        grid = SliceGrid(origins, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
        localize(CTVolume(ball, grid, SeriesSource()), diameter_mm=11.5)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
