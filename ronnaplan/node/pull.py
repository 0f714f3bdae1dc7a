"""Scans fetched from an archive into a folder."""

from __future__ import annotations

import re
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ronnaplan.ct.system_folders import UNFINISHED
from ronnaplan.documents.files import make_folder, move_up
from ronnaplan.errors import InputError, UsageError
from ronnaplan.node.archives import Archive, open_archive
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.facts import UID
from ronnaplan.node.matches import are_days
from ronnaplan.text import printable, whole_number

ADDRESS = re.compile(r"(?P<title>[^@]{1,16})@(?P<host>[^@:]+):(?P<port>[0-9]{1,5})")


@dataclass(frozen=True)
class Wanted:
    """Which studies: those that fit all that is given. A date is YYYYMMDD, or two with a - between."""

    study_uid: str = ""
    patient_id: str = ""
    date: str = ""

    @property
    def keys(self) -> dict[str, str]:
        """The attributes to match; raises `UsageError` where nothing is given, or what is no UID or no date."""
        given = {"StudyInstanceUID": self.study_uid, "PatientID": self.patient_id, "StudyDate": self.date}
        keys = {keyword: value for keyword, value in given.items() if value}
        if not keys:
            raise UsageError("nothing says which study; give its UID, a patient's ID or a date")
        if self.study_uid and UID.fullmatch(self.study_uid) is None:
            raise UsageError(
                f"'{printable(self.study_uid)}' is no study's UID; expected up to 64 digits and points"
            )
        if self.date and not are_days(self.date):
            raise UsageError(
                f"'{printable(self.date)}' is no date; expected YYYYMMDD, or two with a - between, the earlier first"
            )
        return keys


def peer_at(text: str, config: Config) -> Peer:
    """Return the peer that ``text`` names: one of the configuration, TITLE@HOST:PORT, or a DICOMweb address."""
    known = config.named(text)
    if known is not None:
        return known
    if text.startswith(("http://", "https://")):
        return Peer(name="the archive", url=text)
    parts = ADDRESS.fullmatch(text)
    port = whole_number(parts["port"]) if parts else None
    if parts is None or port is None or not 0 < port < 65_536:
        raise UsageError(
            f"'{printable(text)}' is no peer of the configuration; expected one, TITLE@HOST:PORT, or a DICOMweb address"
        )
    return Peer(name=parts["title"], title=parts["title"], host=parts["host"], port=port)


def pull(config: Config, peer: Peer, wanted: Wanted, folder: str | Path, *, by: str | None = None) -> int:
    """Fetch what is ``wanted`` into ``folder``; return the number of instances. For ``by`` see `open_archive`.

    No reader of scans finds a part of a study there, should it not come whole or this program be killed.

    Raises `InputError` where the peer cannot be reached, has no such study, or does not send all of it.
    """
    keys = wanted.keys
    with open_archive(config, peer, by) as archive:
        studies = [
            str(found.StudyInstanceUID) for found in archive.find("STUDY", {"StudyInstanceUID": "", **keys})
        ]
        if not studies:
            raise InputError(f"{peer.name} has no such study; check the UID, the patient's ID or the date")
        target = make_folder(folder)
        return sum(_fetch(archive, study, target) for study in studies)


def _fetch(archive: Archive, study: str, target: Path) -> int:
    """Fetch a study into a folder, all of it or nothing; return the number of instances."""
    part, whole = target / UNFINISHED / study, target / f"{study}.whole"
    try:
        paths = archive.fetch([study], make_folder(part))
        shutil.rmtree(whole, ignore_errors=True)  # of one that was killed while it moved up the same files
        move_up(part, whole, [path.name for path in paths])
    finally:
        shutil.rmtree(part, ignore_errors=True)
        with suppress(OSError):  # another program fetches another study
            part.parent.rmdir()
    return len(paths)
