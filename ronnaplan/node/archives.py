"""Archives that scans are fetched from: asked by C-FIND with C-GET or C-MOVE, or by QIDO-RS and WADO-RS."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from pydicom.dataset import Dataset

from ronnaplan.documents.files import write_atomically
from ronnaplan.errors import InputError, RonnaplanError
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.facts import UID
from ronnaplan.text import printable

if TYPE_CHECKING:
    from pynetdicom.association import Association

FIND = "1.2.840.10008.5.1.4.1.2.2.1"
GET = "1.2.840.10008.5.1.4.1.2.2.3"
MOVE = "1.2.840.10008.5.1.4.1.2.2.2"
PENDING = (0xFF00, 0xFF01)

LEVELS: Final = {"STUDY": "StudyInstanceUID", "SERIES": "SeriesInstanceUID", "IMAGE": "SOPInstanceUID"}
"""What can be asked for, from the whole to its parts, and what names one."""


class Archive(Protocol):
    """Where scans are."""

    def find(self, level: str, keys: Mapping[str, str]) -> list[Dataset]:
        """Return what fits ``keys``, the attributes to match, and empty ones that are to be told.

        At a level below a study the UIDs of what it belongs to are among the keys.
        """
        ...

    def fetch(self, uids: Sequence[str], folder: Path) -> set[Path]:
        """Bring a study, one of its series or one of its instances: its UIDs from the whole to the part."""
        ...


@contextmanager
def open_archive(config: Config, peer: Peer, by: str | None = None) -> Iterator[Archive]:
    """Open a way to ``peer``.

    ``by`` is "get" or "move"; without it an archive that offers both is asked for the former. With C-MOVE instances
    come to the configuration's host and port, which the archive must know by our first AE title.

    Raises `InputError` where it cannot be reached, now or later.
    """
    if peer.url is not None:
        with _reachable(peer):
            yield _Web(peer)
        return
    from pynetdicom import evt

    from ronnaplan.node.association import associated
    from ronnaplan.node.receiver import CLASSES, SYNTAXES

    kept = _Kept()
    ways = {"get": GET, "move": MOVE}
    asked = [FIND, *([ways[by]] if by else ways.values())]
    stored = [] if by == "move" else list(CLASSES)
    handlers = [(evt.EVT_C_STORE, kept.take)]
    with associated(config, peer, asked, stored=stored, syntaxes=SYNTAXES, handlers=handlers) as association:
        offered = {one.abstract_syntax for one in association.accepted_contexts}
        way = next((uid for uid in asked[1:] if uid in offered), None)
        if way is None or FIND not in offered:
            raise InputError(
                f"{peer.name} offers neither C-GET nor C-MOVE of studies, or no C-FIND; expected both"
            )
        with ExitStack() as stack:
            if way == MOVE:
                from ronnaplan.node.destination import destination

                stack.enter_context(destination(config, peer, handlers))
            yield _Dimse(config, peer, association, way, kept)


class _Kept:
    """Keeps what an archive sends."""

    def __init__(self) -> None:
        self.folder = Path()
        self.paths: set[Path] = set()

    def take(self, event: Any) -> int:
        try:
            self.paths.add(_keep(self.folder, event.request.AffectedSOPInstanceUID, event.encoded_dataset()))
        except RonnaplanError:
            return 0xA700
        return 0x0000


class _Dimse:
    def __init__(self, config: Config, peer: Peer, association: Association, way: str, kept: _Kept) -> None:
        self._config, self._peer, self._association, self._way, self._kept = config, peer, association, way, kept

    def find(self, level: str, keys: Mapping[str, str]) -> list[Dataset]:
        told = self._told(self._association.send_c_find(_query(level, keys), FIND))
        found = [one for one in told if one is not None]
        if len(found) < len(told):
            raise InputError(f"{self._peer.name} answered what cannot be read; expected a dataset for each match")
        return found

    def fetch(self, uids: Sequence[str], folder: Path) -> set[Path]:
        self._kept.folder, self._kept.paths = folder, set()
        level = list(LEVELS)[len(uids) - 1]
        order = _query(level, dict(zip(LEVELS.values(), uids, strict=False)))
        if self._way == GET:
            answers = self._association.send_c_get(order, GET)
        else:
            answers = self._association.send_c_move(order, self._config.titles[0], MOVE)
        self._told(answers)
        return self._kept.paths

    def _told(self, answers: Any) -> list[Dataset | None]:
        """Return what was told before the end, None without a dataset; raises `InputError` for an end that is none."""
        before = []
        for status, found in answers:
            code = status.get("Status")
            if code in PENDING:
                before.append(found)
            elif code != 0:
                said = "nothing more" if code is None else f"{code:04X}"
                raise InputError(f"{self._peer.name} answered {said}; expected all of the study")
        return before


class _Web:
    def __init__(self, peer: Peer) -> None:
        from dicomweb_client.api import DICOMwebClient

        self._client: Any = DICOMwebClient(str(peer.url))

    def find(self, level: str, keys: Mapping[str, str]) -> list[Dataset]:
        above = [keys[name] for name in list(LEVELS.values())[: list(LEVELS).index(level)]]
        ways = (
            self._client.search_for_studies,
            self._client.search_for_series,
            self._client.search_for_instances,
        )
        filters = {name: value for name, value in keys.items() if value and value not in above}
        fields = [name for name, value in keys.items() if not value]
        found = ways[len(above)](*above, search_filters=filters, fields=fields)
        return [Dataset.from_json(one) for one in found]

    def fetch(self, uids: Sequence[str], folder: Path) -> set[Path]:
        if len(uids) == len(LEVELS):
            instances = [self._client.retrieve_instance(*uids)]
        else:
            instances = (self._client.iter_study, self._client.iter_series)[len(uids) - 1](*uids)
        kept = set()
        for instance in instances:
            file = io.BytesIO()
            instance.save_as(file, enforce_file_format=True)
            kept.add(_keep(folder, instance.SOPInstanceUID, file.getvalue()))
        return kept


def _query(level: str, keys: Mapping[str, str]) -> Dataset:
    query = Dataset()
    query.QueryRetrieveLevel = level
    for keyword, value in keys.items():
        setattr(query, keyword, value)
    return query


@contextmanager
def _reachable(peer: Peer) -> Iterator[None]:
    import requests

    try:
        yield
    except (requests.RequestException, OSError) as error:
        raise InputError(f"{peer.name} cannot be reached by DICOMweb: {error}") from error


def _keep(folder: Path, sop_uid: str, content: bytes) -> Path:
    if UID.fullmatch(str(sop_uid)) is None:
        raise InputError(f"an instance has the UID '{printable(sop_uid, 80)}'; expected digits and points")
    path = folder / f"{sop_uid}.dcm"
    write_atomically(path, content)
    return path
