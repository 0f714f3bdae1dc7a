"""What an archive has, to choose from: its series, each with a small picture."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ronnaplan.errors import InputError
from ronnaplan.node.archives import Archive, open_archive
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.pull import Wanted
from ronnaplan.text import printable, whole_number

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from pydicom.dataset import Dataset

MOST_SERIES: Final = 500

STUDY_TOLD: Final = ("StudyInstanceUID", "StudyDate", "StudyDescription", "PatientID", "PatientName")
SERIES_TOLD: Final = ("SeriesInstanceUID", "Modality", "SeriesDescription", "NumberOfSeriesRelatedInstances")


@dataclass(frozen=True)
class Listed:
    """A series of an archive, in texts that are safe to print; who it is of is for the one who chooses only."""

    study_uid: str
    series_uid: str
    patient_id: str
    patient_name: str
    date: str
    study: str
    modality: str
    description: str
    instances: int | None
    """None where the archive does not tell."""


def listed_series(archive: Archive, wanted: Wanted) -> list[Listed]:
    """Return the series of the studies that are ``wanted``, at most `MOST_SERIES`.

    Raises `InputError` where there are more, or the archive gives no answer.
    """
    found = []
    for study in archive.find("STUDY", {**dict.fromkeys(STUDY_TOLD, ""), **wanted.keys}):
        uid = str(study.StudyInstanceUID)
        for series in archive.find("SERIES", {**dict.fromkeys(SERIES_TOLD, ""), "StudyInstanceUID": uid}):
            found.append(_listed(study, series))
            if len(found) > MOST_SERIES:
                raise InputError(f"more than {MOST_SERIES} series fit; give a patient's ID or fewer days")
    return found


def thumbnail(archive: Archive, series: Listed) -> NDArray[np.uint8] | None:
    """Fetch the middle instance of a series; return it as a small picture (J, I) in grey, None where it shows none.

    Raises `InputError` where the archive gives no answer.
    """
    from ronnaplan.ct import find_series
    from ronnaplan.ct.preview import preview

    above = {"StudyInstanceUID": series.study_uid, "SeriesInstanceUID": series.series_uid}
    images = archive.find("IMAGE", {**above, "SOPInstanceUID": "", "InstanceNumber": ""})
    if not images:
        return None
    images.sort(key=lambda one: (whole_number(str(one.get("InstanceNumber", ""))) or 0, str(one.SOPInstanceUID)))
    middle = str(images[len(images) // 2].SOPInstanceUID)
    with tempfile.TemporaryDirectory(prefix="ronnaplan-") as folder:
        archive.fetch([series.study_uid, series.series_uid, middle], Path(folder))
        return next((preview(one) for one in find_series(folder).series), None)


class Shelf:
    """A peer's series to choose from, by number; each request is an association of its own.

    A patient's name is told only if it ``names`` patients.
    """

    def __init__(self, config: Config, peer: Peer, *, names: bool = False) -> None:
        self._config, self._peer, self._names = config, peer, names
        self._listed: list[Listed] = []

    @property
    def name(self) -> str:
        """What the peer is called."""
        return self._peer.name

    def look(self, patient_id: str, date: str) -> list[dict[str, Any]]:
        """Return the series of a patient, of a day or of days, the newest first."""
        with open_archive(self._config, self._peer) as archive:
            found = listed_series(archive, Wanted(patient_id=patient_id, date=date))
        self._listed = sorted(found, key=lambda one: one.date, reverse=True)
        rows = [asdict(one) for one in self._listed]
        return rows if self._names else [{**one, "patient_name": ""} for one in rows]

    def picture(self, number: int) -> NDArray[np.uint8] | None:
        """Return a picture (J, I) of the middle of a series that was listed; see `thumbnail`."""
        with open_archive(self._config, self._peer) as archive:
            return thumbnail(archive, self._at(number))

    def fetch(self, number: int, folder: Path) -> None:
        """Bring a series that was listed."""
        one = self._at(number)
        with open_archive(self._config, self._peer) as archive:
            archive.fetch([one.study_uid, one.series_uid], folder)

    def _at(self, number: int) -> Listed:
        if not 0 <= number < len(self._listed):
            raise InputError("that series is no longer listed; look for it again")
        return self._listed[number]


def _listed(study: Dataset, series: Dataset) -> Listed:
    def told(given: Dataset, keyword: str) -> str:
        return printable(given.get(keyword) or "")

    return Listed(
        study_uid=told(study, "StudyInstanceUID"),
        series_uid=told(series, "SeriesInstanceUID"),
        patient_id=told(study, "PatientID"),
        patient_name=told(study, "PatientName"),
        date=told(study, "StudyDate"),
        study=told(study, "StudyDescription"),
        modality=told(series, "Modality"),
        description=told(series, "SeriesDescription"),
        instances=whole_number(told(series, "NumberOfSeriesRelatedInstances")),
    )
