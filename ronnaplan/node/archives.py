"""Archives that scans are fetched from: asked by C-FIND with C-GET or C-MOVE, or by QIDO-RS and WADO-RS."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from pydicom.dataset import Dataset

from ronnaplan.errors import InputError, RonnaplanError
from ronnaplan.node.arrivals import MOST_INSTANCES, Arrivals
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.matches import LEVELS, fitting
from ronnaplan.node.web import AS_STORED, is_unacceptable, unreached, web_client
from ronnaplan.text import printable

if TYPE_CHECKING:
    from pynetdicom.association import Association

FIND = "1.2.840.10008.5.1.4.1.2.2.1"
GET = "1.2.840.10008.5.1.4.1.2.2.3"
MOVE = "1.2.840.10008.5.1.4.1.2.2.2"
PENDING = (0xFF00, 0xFF01)
MOST_PAGES: Final = 1_000
"""No archive tells what fits a question in so many pieces."""
RARE_CLASS = "; should it hold what is asked for seldom, try --by move or DICOMweb"
"""What to do where C-GET fails, for which not all classes can be agreed on."""


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
            yield _Web(config, peer)
        return
    from pynetdicom import evt

    from ronnaplan.node.association import associated
    from ronnaplan.node.destination import asked_for, destination

    kept = Arrivals()
    ways = {"get": GET, "move": MOVE}
    asked = [FIND, *([ways[by]] if by else ways.values())]
    stored = [] if by == "move" else asked_for()
    handlers = [(evt.EVT_C_STORE, kept.take)]
    with associated(config, peer, asked, stored=stored, handlers=handlers) as association:
        offered = {one.abstract_syntax for one in association.accepted_contexts}
        way = next((uid for uid in asked[1:] if uid in offered), None)
        if way is None or FIND not in offered:
            raise InputError(
                f"{peer.name} offers neither C-GET nor C-MOVE of studies, or no C-FIND; expected both"
            )
        with ExitStack() as stack:
            if way == MOVE:
                stack.enter_context(destination(config, peer, handlers))
            yield _Dimse(config, peer, association, way, kept)


class _Dimse:
    def __init__(self, config: Config, peer: Peer, association: Association, way: str, kept: Arrivals) -> None:
        self._config, self._peer, self._association, self._way, self._kept = config, peer, association, way, kept

    def find(self, level: str, keys: Mapping[str, str]) -> list[Dataset]:
        with _understood(self._peer):
            told = self._told(self._association.send_c_find(_query(level, keys), FIND))
            found = [one for one in told if one is not None]
            if len(found) < len(told):
                raise InputError(
                    f"{self._peer.name} answered what cannot be read; expected a dataset for each match"
                )
            return fitting(self._peer.name, level, keys, found)

    def fetch(self, uids: Sequence[str], folder: Path) -> set[Path]:
        self._kept.expect(uids, folder)
        level = list(LEVELS)[len(uids) - 1]
        order = _query(level, dict(zip(LEVELS.values(), uids, strict=False)))
        try:
            if self._way == GET:
                self._told(self._association.send_c_get(order, GET), RARE_CLASS)
            else:
                self._told(self._association.send_c_move(order, self._config.titles[0], MOVE))
        except InputError:
            self._kept.require_kept(self._peer.name)  # what this side could not keep is why the archive failed
            raise
        # an archive may answer C-MOVE before it has sent anything
        patience_s = 0.0 if self._way == GET else self._config.limits.silent_s
        return self._kept.all_of(self._peer.name, _instances(self, uids), patience_s)

    def _told(self, answers: Any, remedy: str = "") -> list[Dataset | None]:
        """Return what was told before the end, None without a dataset; raises `InputError` for an end that is none."""
        before = []
        for status, found in answers:
            code = status.get("Status")
            if code in PENDING:
                before.append(found)
                if len(before) > MOST_INSTANCES:
                    self._association.abort()  # it would go on
                    raise _more_than_told(self._peer)
            elif code != 0:
                said = "nothing more" if code is None else f"{code:04X}"
                raise InputError(f"{self._peer.name} answered {said}; expected all of the study{remedy}")
        return before


class _Web:
    def __init__(self, config: Config, peer: Peer) -> None:
        self._peer, self._kept = peer, Arrivals()
        self._client, self._heard = web_client(peer, config.limits)
        self._as_stored: dict[str, Any] = {"media_types": AS_STORED}

    def find(self, level: str, keys: Mapping[str, str]) -> list[Dataset]:
        above = [keys[name] for name in list(LEVELS.values())[: list(LEVELS).index(level)]]
        ways = (
            self._client.search_for_studies,
            self._client.search_for_series,
            self._client.search_for_instances,
        )
        filters = {name: value for name, value in keys.items() if value and value not in above}
        fields = [name for name, value in keys.items() if not value]
        found: dict[str, Dataset] = {}
        for _ in range(MOST_PAGES):  # a list comes in pages, and not every archive says that there is another one
            with _understood(self._peer):
                told = ways[len(above)](*above, search_filters=filters, fields=fields, offset=len(found) or None)
                page = fitting(self._peer.name, level, keys, [Dataset.from_json(one) for one in told])
            known = len(found)
            for one in page:
                found.setdefault(str(one[LEVELS[level]].value), one)
            if len(found) == known and not self._heard.has_more:
                return list(found.values())
            if len(found) == known or len(found) > MOST_INSTANCES:
                break
        raise _more_than_told(self._peer)

    def fetch(self, uids: Sequence[str], folder: Path) -> set[Path]:
        self._kept.expect(uids, folder)
        with _understood(self._peer):
            try:
                self._retrieve(uids, **self._as_stored)
            except OSError as error:
                if not (self._as_stored and is_unacceptable(error)):
                    raise
                self._retrieve(uids)
                self._as_stored = {}  # it would be asked in vain for each study
        return self._kept.all_of(self._peer.name, _instances(self, uids))

    def _retrieve(self, uids: Sequence[str], **told: Any) -> None:
        """Keep the instances of a study, of one of its series, or the one named."""
        if len(uids) == len(LEVELS):
            instances = [self._client.retrieve_instance(*uids, **told)]
        else:
            instances = (self._client.iter_study, self._client.iter_series)[len(uids) - 1](*uids, **told)
        for instance in instances:
            file = io.BytesIO()
            instance.save_as(file, enforce_file_format=True)
            self._kept.keep(instance.SOPInstanceUID, file.getvalue())


def _more_than_told(peer: Peer) -> InputError:
    return InputError(f"{peer.name} has more matches than it tells, or tells no end of them; ask for fewer days")


def _instances(archive: Archive, uids: Sequence[str]) -> set[str]:
    """Return the UIDs of all instances that an archive lists of a study, of one of its series, or the one named."""
    if len(uids) == len(LEVELS):
        return {uids[-1]}
    given = dict(zip(LEVELS.values(), uids, strict=False))
    level = list(LEVELS)[len(uids)]
    found = [str(one[LEVELS[level]].value) for one in archive.find(level, {**given, LEVELS[level]: ""})]
    return set(found) if level == "IMAGE" else set().union(*(_instances(archive, [*uids, one]) for one in found))


def _query(level: str, keys: Mapping[str, str]) -> Dataset:
    query = Dataset()
    query.QueryRetrieveLevel = level
    if not "".join(keys.values()).isascii():  # what the default set lacks would go out as ?, which fits anything
        query.SpecificCharacterSet = "ISO_IR 192"
    for keyword, value in keys.items():
        setattr(query, keyword, value)
    return query


@contextmanager
def _understood(peer: Peer) -> Iterator[None]:
    """Have an answer that cannot be read told of as an `InputError`; what is merely odd in it is passed over."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (RonnaplanError, OSError):
        raise
    except Exception as error:  # pydicom and the client of DICOMweb raise many kinds
        told = printable(f"{type(error).__name__}: {error}")
        raise InputError(f"{peer.name} sent what cannot be read ({told}); check its address") from error


@contextmanager
def _reachable(peer: Peer) -> Iterator[None]:
    import requests

    try:
        yield
    except (requests.RequestException, OSError) as error:
        raise unreached(peer, error) from error
