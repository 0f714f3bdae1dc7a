"""Documents that come later than the scan, and the objects that they become: a registration, a plan.

They lie in a folder of the rule's, in a folder for each study, and are worked on when they come or change.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from ronnaplan.node.config import Config
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log

LOOK_S: Final = 5.0
KINDS: Final = {"registration": "registration.json", "plan": "plan.json"}
"""Kinds of answers, and the documents that they are made of."""


class PapersWatch:
    """Has finished jobs done again, as far as documents are concerned, when these are there or have changed."""

    def __init__(self, config: Config, index: Index, log: Log) -> None:
        self._config, self._index, self._log, self._due = config, index, log, 0.0
        self._unread: dict[str, str] = {}
        """Why the folders of rules cannot be looked into."""

    def tick(self, now: float) -> None:
        """Look, at most every `LOOK_S`, what is there at ``now`` (seconds since 1970)."""
        if now < self._due <= now + LOOK_S:  # later than that by a clock that was ahead
            return
        self._due = now + LOOK_S
        for rule in self._config.rule:
            reason = self._look_into(rule.name, self._config.home / rule.documents, now) if rule.documents else ""
            if reason and reason != self._unread.get(rule.name):
                self._log.tell("documents unread", rule=rule.name, reason=reason)
            self._unread[rule.name] = reason

    def _look_into(self, rule: str, home: Path, now: float) -> str:
        """Look at the studies' folders in a rule's; returns why one cannot be, which keeps no other one waiting."""
        reason = ""
        try:
            folders = sorted(home.iterdir()) if home.is_dir() else []
        except OSError as error:
            return str(error)
        for folder in folders:
            try:
                self._look(rule, folder, now)
            except OSError as error:
                reason = reason or str(error)
        return reason

    def _look(self, rule: str, folder: Path, now: float) -> None:
        stamp = stamp_of(folder)
        jobs = self._index.rows(
            "SELECT jobs.id FROM jobs JOIN series ON series = series.id WHERE study_uid = ? AND rule = ?"
            " AND jobs.revision = series.revision AND state = 'done'"
            " AND NOT EXISTS (SELECT 1 FROM documents WHERE job = jobs.id AND stamp = ?)",
            *(folder.name, rule, stamp),
        )
        for (job,) in jobs if stamp else ():
            with self._index.transaction():
                self._index.run(
                    "INSERT INTO documents VALUES (?, ?) ON CONFLICT DO UPDATE SET stamp = excluded.stamp",
                    job,
                    stamp,
                )
                self._index.run("UPDATE jobs SET state = 'waiting', attempts = 0, due = ? WHERE id = ?", now, job)
            self._log.tell("documents", job=job, study=folder.name)


def stamp_of(folder: Path) -> str:
    """Return what tells one state of a study's documents from another one; nothing where there are none."""
    found = []
    for name in KINDS.values():
        path = folder / name
        if path.is_file():
            state = path.stat()
            found.append(f"{name} {state.st_size} {state.st_mtime_ns}")
    return ", ".join(found)


def object_of(kind: str, path: Path, scan: Path, tell: Callable[[str], None]) -> Any:
    """Return the object of a document of the series in the folder ``scan``, with its patient and study.

    ``tell`` is told what of these is left empty. Raises `RonnaplanError` for a document of another series, a refused
    registration, or what is no such document.
    """
    from ronnaplan.documents.dicom_spatial import spatial_registration
    from ronnaplan.documents.fiducials import Source
    from ronnaplan.documents.patient import patient_of_scan
    from ronnaplan.documents.plan import read_plan
    from ronnaplan.documents.registration import read_registration
    from ronnaplan.node.sr import planned_trajectories

    if kind == "registration":
        document = read_registration(path)
        return spatial_registration(document, patient_of_scan(scan, document.source, tell))
    plan = read_plan(path)
    source = Source.model_validate(plan.source.uids)
    return planned_trajectories(plan, source, patient_of_scan(scan, source, tell), sorted(scan.glob("*.dcm")))
