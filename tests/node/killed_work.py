"""A worker that answers every scan with one small object, whose UID is that of what it was made of."""

from __future__ import annotations

import json

from pydicom import dcmread

from ronnaplan.documents.dicom_spatial import FIDUCIALS, begin_object, dicom_bytes
from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.files import make_folder, write_atomically
from ronnaplan.jobs.processes import end_with_parent
from ronnaplan.node.work import Order


def obey(line: str) -> None:
    order = Order.parse(line)
    if "fiducials" not in order.have:
        images = [dcmread(path) for path in sorted(order.folder.glob("*.dcm"))]
        content = " ".join(str(one.SOPInstanceUID) for one in images)
        source = Source(study_instance_uid=str(images[0].StudyInstanceUID))
        made = begin_object(FIDUCIALS, source, content, None)
        made.ContentDescription = str(images[0].SeriesInstanceUID)
        path = make_folder(order.output) / f"{made.SOPInstanceUID}.dcm"
        write_atomically(path, dicom_bytes(made))
        tell(
            event="answer",
            job=order.job,
            kind="fiducials",
            sop_uid=made.SOPInstanceUID,
            sop_class=made.SOPClassUID,
            path=str(path),
        )
    tell(event="ended", job=order.job, state="done", reason="")


def tell(**facts: object) -> None:
    print(json.dumps(facts), flush=True)


if __name__ == "__main__":
    tell(event="ready")
    end_with_parent(obey)
