"""What an archive sends of what it was asked for: kept, and held against what it says that it has."""

from __future__ import annotations

import threading
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from ronnaplan.documents.files import write_atomically
from ronnaplan.errors import InputError, RonnaplanError
from ronnaplan.node.facts import UID, read_facts
from ronnaplan.text import printable

MOST_INSTANCES: Final = 100_000
"""No archive has so many of one study, nor lists so many that fit a question for one day or patient."""
MOST_COPIES: Final = 100
"""Instances that may come again; of a study of more as many as it has."""
TAKEN: Final = 0x0000
NOT_TAKEN: Final = 0xA700


class EndlessError(InputError):
    """An archive sends more than there can be."""


class Arrivals:
    """Keeps what comes of one request at a time."""

    def __init__(self) -> None:
        self._folder = Path()
        self._uids: tuple[str, ...] = ()
        self._paths: dict[str, Path] = {}
        self._trouble, self._copies = "", 0
        self._changed = threading.Condition()

    def expect(self, uids: Sequence[str], folder: Path) -> None:
        """From now on keep, in ``folder``, what belongs to ``uids``: a study, its series, its instance."""
        with self._changed:
            self._folder, self._uids = folder, tuple(uids)
            self._paths, self._trouble, self._copies = {}, "", 0

    def take(self, event: Any) -> int:
        """Keep an instance that comes by C-STORE; return its status."""
        try:
            self.keep(event.request.AffectedSOPInstanceUID, event.encoded_dataset())
        except (RonnaplanError, OSError) as error:
            self._trouble = self._trouble or str(error)
            if isinstance(error, EndlessError):
                event.assoc.abort()
                # who asked waits for an answer, which would never come
                event.assoc.dimse.msg_queue.put((None, None))
            return NOT_TAKEN
        return TAKEN

    def keep(self, sop_uid: str, content: bytes) -> None:
        """Keep an instance; raises `InputError` for one that is another, or belongs to something else."""
        if UID.fullmatch(str(sop_uid)) is None:
            raise InputError(
                f"an instance has the UID '{printable(sop_uid, 80)}'; expected up to 64 digits and points"
            )
        with self._changed:
            self._copies += str(sop_uid) in self._paths
            if self._copies > max(MOST_COPIES, len(self._paths)) or len(self._paths) > MOST_INSTANCES:
                raise EndlessError("instances come without end; fetch less, or see to the archive")
            path = self._folder / f"{sop_uid}.dcm"
            write_atomically(path, content)
            try:
                facts = read_facts(path, "")
                told = (facts.study_uid, facts.series_uid, facts.sop_uid)
                if told[: len(self._uids)] != self._uids or facts.sop_uid != sop_uid:
                    raise InputError(f"instance {sop_uid} came, which was not asked for")
            except RonnaplanError:
                with suppress(OSError):
                    path.unlink()
                raise
            self._paths[str(sop_uid)] = path
            self._changed.notify_all()

    def require_kept(self, archive: str) -> None:
        """Raise `InputError` where something that ``archive`` sent was not kept."""
        if self._trouble:
            raise InputError(f"{archive} sent what is not kept: {self._trouble}")

    def all_of(self, archive: str, listed: Collection[str], patience_s: float = 0.0) -> set[Path]:
        """Return the files of the instances that ``archive`` lists, once all came.

        Raises `InputError` where some did not, and none more comes for ``patience_s``; or where one was not kept.
        """
        wanted = set(listed)
        with self._changed:
            while not self._trouble and wanted - self._paths.keys():
                if not self._changed.wait(patience_s):
                    break
            missing = len(wanted - self._paths.keys())
            self.require_kept(archive)
            if missing or not self._paths:
                raise InputError(
                    f"{archive} lists {len(wanted)} instances and sent {len(wanted) - missing} of them; expected all"
                )
            return set(self._paths.values())
