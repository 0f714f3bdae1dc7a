"""Scans fetched from an archive into a folder: C-FIND with C-GET or C-MOVE, or QIDO-RS and WADO-RS."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydicom.dataset import Dataset

from ronnaplan.documents.files import make_folder, write_atomically
from ronnaplan.errors import InputError, RonnaplanError, UsageError
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.facts import UID
from ronnaplan.text import printable, whole_number

FIND = "1.2.840.10008.5.1.4.1.2.2.1"
GET = "1.2.840.10008.5.1.4.1.2.2.3"
MOVE = "1.2.840.10008.5.1.4.1.2.2.2"
PENDING = (0xFF00, 0xFF01)
ADDRESS = re.compile(r"(?P<title>[^@]{1,16})@(?P<host>[^@:]+):(?P<port>[0-9]{1,5})")


@dataclass(frozen=True)
class Wanted:
    """Which studies: those that fit all that is given. A date is YYYYMMDD, or two with a - between."""

    study_uid: str = ""
    patient_id: str = ""
    date: str = ""

    @property
    def keys(self) -> dict[str, str]:
        """The attributes to match."""
        given = {"StudyInstanceUID": self.study_uid, "PatientID": self.patient_id, "StudyDate": self.date}
        return {keyword: value for keyword, value in given.items() if value}


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
    """Fetch what is ``wanted`` into ``folder``; return the number of instances.

    ``by`` is "get" or "move"; without it an archive that offers both is asked for the former. With C-MOVE instances
    come to the configuration's host and port, which the archive must know by its first AE title.

    Raises `InputError` where the peer cannot be reached, has no such study, or does not send all of it.
    """
    if not wanted.keys:
        raise UsageError("nothing says which study; give its UID, a patient's ID or a date")
    target = make_folder(folder)
    return _from_web(peer, wanted, target) if peer.url else _from_archive(config, peer, wanted, target, by)


def _from_archive(config: Config, peer: Peer, wanted: Wanted, folder: Path, by: str | None) -> int:
    from pynetdicom import evt

    from ronnaplan.node.association import associated
    from ronnaplan.node.destination import destination
    from ronnaplan.node.receiver import CLASSES, SYNTAXES

    kept: list[Path] = []

    def take(event: Any) -> int:
        try:
            kept.append(_keep(folder, event.request.AffectedSOPInstanceUID, event.encoded_dataset()))
        except RonnaplanError:
            return 0xA700
        return 0x0000

    handlers = [(evt.EVT_C_STORE, take)]
    ways = {"get": GET, "move": MOVE}
    asked = [FIND, *([ways[by]] if by else ways.values())]
    stored = [] if by == "move" else list(CLASSES)
    with associated(config, peer, asked, stored=stored, syntaxes=SYNTAXES, handlers=handlers) as archive:
        offered = {one.abstract_syntax for one in archive.accepted_contexts}
        way = next((uid for uid in asked[1:] if uid in offered), None)
        if way is None or FIND not in offered:
            raise InputError(
                f"{peer.name} offers neither C-GET nor C-MOVE of studies, or no C-FIND; expected both"
            )
        query = Dataset()
        query.QueryRetrieveLevel, query.StudyInstanceUID = "STUDY", ""
        for keyword, value in wanted.keys.items():
            setattr(query, keyword, value)
        studies = [str(found.StudyInstanceUID) for found in _answers(peer, archive.send_c_find(query, FIND))]
        _require_some(studies, peer)
        with ExitStack() as stack:
            if way == MOVE:
                stack.enter_context(destination(config, peer, handlers))
            for study in studies:
                order = Dataset()
                order.QueryRetrieveLevel, order.StudyInstanceUID = "STUDY", study
                if way == GET:
                    answers = archive.send_c_get(order, GET)
                else:
                    answers = archive.send_c_move(order, config.titles[0], MOVE)
                list(_answers(peer, answers))
    return len(set(kept))


def _answers(peer: Peer, answers: Any) -> Iterator[Dataset]:
    """Yield what matches; raises `InputError` for the end that is none."""
    for status, found in answers:
        told = status.get("Status")
        if told in PENDING:
            if found is not None:
                yield found
        elif told != 0:
            said = "nothing more" if told is None else f"{told:04X}"
            raise InputError(f"{peer.name} answered {said}; expected all of the study")


def _from_web(peer: Peer, wanted: Wanted, folder: Path) -> int:
    import requests
    from dicomweb_client.api import DICOMwebClient

    client = DICOMwebClient(str(peer.url))
    kept = set()
    try:
        found = client.search_for_studies(search_filters=wanted.keys)
        studies = [str(Dataset.from_json(one).StudyInstanceUID) for one in found]
        _require_some(studies, peer)
        for study in studies:
            for instance in client.iter_study(study):
                file = io.BytesIO()
                instance.save_as(file, enforce_file_format=True)
                kept.add(_keep(folder, instance.SOPInstanceUID, file.getvalue()))
    except (requests.RequestException, OSError) as error:
        raise InputError(f"{peer.name} cannot be reached by DICOMweb: {error}") from error
    return len(kept)


def _require_some(studies: list[str], peer: Peer) -> None:
    if not studies:
        raise InputError(f"{peer.name} has no such study; check the UID, the patient's ID or the date")


def _keep(folder: Path, sop_uid: str, content: bytes) -> Path:
    if UID.fullmatch(str(sop_uid)) is None:
        raise InputError(f"an instance has the UID '{printable(sop_uid, 80)}'; expected digits and points")
    path = folder / f"{sop_uid}.dcm"
    write_atomically(path, content)
    return path
