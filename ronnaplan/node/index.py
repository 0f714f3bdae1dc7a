"""The index: what was received, what is to be done with it, what goes where. SQLite with a write-ahead log.

A transaction is on the disk when it ends (``synchronous = FULL``). Every process of the node opens its own connection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ronnaplan.jobs.database import Database
from ronnaplan.node.facts import Facts

FILE = "index.sqlite"
LONGEST_WAIT_S: Final = 3600.0
"""For so long at most anything is put off."""

SCHEMA = """
CREATE TABLE IF NOT EXISTS series (
    id INTEGER PRIMARY KEY,
    study_uid TEXT NOT NULL, series_uid TEXT NOT NULL,
    modality TEXT NOT NULL, description TEXT NOT NULL, station TEXT NOT NULL, protocol TEXT NOT NULL,
    calling TEXT NOT NULL, called TEXT NOT NULL,
    begun REAL NOT NULL,                    -- times in seconds since 1970
    received REAL NOT NULL,                 -- the newest instance
    instances INTEGER NOT NULL DEFAULT 0, bytes INTEGER NOT NULL DEFAULT 0,
    expected INTEGER,                       -- instances that it has as far as anybody said
    revision INTEGER NOT NULL DEFAULT 0,    -- grows with every instance
    complete INTEGER NOT NULL DEFAULT 0,    -- the revision that was found complete
    UNIQUE (study_uid, series_uid)
);
CREATE TABLE IF NOT EXISTS instances (
    sop_uid TEXT PRIMARY KEY, series INTEGER NOT NULL REFERENCES series (id) ON DELETE CASCADE,
    sop_class TEXT NOT NULL, path TEXT NOT NULL, sha256 TEXT NOT NULL, bytes INTEGER NOT NULL, received REAL NOT NULL
) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS instances_of_series ON instances (series);
CREATE TABLE IF NOT EXISTS aside (
    path TEXT PRIMARY KEY, sop_uid TEXT NOT NULL, calling TEXT NOT NULL, received REAL NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS jobs (
    id INTEGER PRIMARY KEY, series INTEGER NOT NULL REFERENCES series (id) ON DELETE CASCADE,
    revision INTEGER NOT NULL, rule TEXT NOT NULL,
    state TEXT NOT NULL, attempts INTEGER NOT NULL DEFAULT 0, due REAL NOT NULL, reason TEXT NOT NULL DEFAULT '',
    completed REAL NOT NULL, ended REAL,
    UNIQUE (series, revision)
);
CREATE TABLE IF NOT EXISTS answers (
    sop_uid TEXT PRIMARY KEY, job INTEGER NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    kind TEXT NOT NULL, sop_class TEXT NOT NULL, path TEXT NOT NULL, made REAL NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS deliveries (
    answer TEXT NOT NULL REFERENCES answers (sop_uid) ON DELETE CASCADE, receiver TEXT NOT NULL,
    state TEXT NOT NULL, attempts INTEGER NOT NULL DEFAULT 0, due REAL NOT NULL, reason TEXT NOT NULL DEFAULT '',
    sent REAL,
    PRIMARY KEY (answer, receiver)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS asked (          -- answers that a receiver was asked to promise to keep
    transaction_uid TEXT NOT NULL, answer TEXT NOT NULL, receiver TEXT NOT NULL,
    PRIMARY KEY (transaction_uid, answer),
    FOREIGN KEY (answer, receiver) REFERENCES deliveries (answer, receiver) ON DELETE CASCADE
) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS asked_by_delivery ON asked (answer, receiver);
CREATE TABLE IF NOT EXISTS commitments (    -- what senders are to be told of
    transaction_uid TEXT NOT NULL, peer TEXT NOT NULL, named TEXT NOT NULL,
    attempts INTEGER NOT NULL DEFAULT 0, due REAL NOT NULL, received REAL NOT NULL,
    PRIMARY KEY (transaction_uid, peer)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS steps (          -- modality performed procedure steps
    sop_uid TEXT PRIMARY KEY, calling TEXT NOT NULL, state TEXT NOT NULL, received REAL NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS announced (      -- how many instances a series has, as its scanner says
    series_uid TEXT PRIMARY KEY, instances INTEGER NOT NULL, received REAL NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS lacking (        -- instances that there was no room for, which their senders keep
    study_uid TEXT NOT NULL, series_uid TEXT NOT NULL, sop_uid TEXT NOT NULL, received REAL NOT NULL,
    PRIMARY KEY (study_uid, series_uid, sop_uid)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS documents (      -- what a job has made objects of, beside the scan
    job INTEGER PRIMARY KEY REFERENCES jobs (id) ON DELETE CASCADE, stamp TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS clock (          -- when it was last looked at, and by what time to judge until when
    id INTEGER PRIMARY KEY, looked REAL NOT NULL, trusted REAL NOT NULL, until REAL NOT NULL
);
CREATE INDEX IF NOT EXISTS deliveries_by_state ON deliveries (state, due);
"""


OF_SERIES = "lacking.study_uid = series.study_uid AND lacking.series_uid = series.series_uid"


@dataclass(frozen=True)
class SeriesRow:
    """A series as the index knows it."""

    id: int
    study_uid: str
    series_uid: str
    modality: str
    description: str
    station: str
    protocol: str
    calling: str
    called: str
    begun: float
    received: float
    instances: int
    bytes: int
    expected: int | None
    revision: int
    complete: int


class Index(Database):
    """One connection to the index of the node that keeps its data in ``folder``; one thread at a time uses it."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / FILE, SCHEMA)

    def known(self, sop_uids: Sequence[str]) -> dict[str, str]:
        """Return the SHA-256 of those instances that there are."""
        marks = ", ".join("?" * len(sop_uids))
        return dict(self.rows(f"SELECT sop_uid, sha256 FROM instances WHERE sop_uid IN ({marks})", *sop_uids))

    def add(self, facts: Facts, path: str, calling: str, called: str, now: float) -> None:
        """Enter an instance, within a transaction; its series is made, or opened again, with it."""
        self.run(
            "INSERT INTO series (study_uid, series_uid, modality, description, station, protocol, calling, called,"
            " begun, received) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
            *(facts.study_uid, facts.series_uid, facts.modality, facts.description, facts.station),
            *(facts.protocol, calling, called, now, now),
        )
        self.run(
            "UPDATE series SET received = ?, instances = instances + 1, bytes = bytes + ?, revision = revision + 1,"
            " expected = COALESCE(?, expected, (SELECT instances FROM announced WHERE series_uid = series.series_uid))"
            " WHERE study_uid = ? AND series_uid = ?",
            *(now, facts.size, facts.expected, facts.study_uid, facts.series_uid),
        )
        self.run(
            "INSERT INTO instances SELECT ?, id, ?, ?, ?, ?, ? FROM series WHERE study_uid = ? AND series_uid = ?",
            *(facts.sop_uid, facts.sop_class, path, facts.sha256, facts.size, now),
            *(facts.study_uid, facts.series_uid),
        )
        self.run(
            "DELETE FROM lacking WHERE study_uid = ? AND series_uid = ? AND sop_uid = ?",
            *(facts.study_uid, facts.series_uid, facts.sop_uid),
        )

    def note_lacking(self, facts: Facts, now: float) -> None:
        """Note an instance that its series lacks, as there was no room for it."""
        if not self.known([facts.sop_uid]):
            self.run(
                "INSERT OR REPLACE INTO lacking VALUES (?, ?, ?, ?)",
                *(facts.study_uid, facts.series_uid, facts.sop_uid, now),
            )

    def lacking(self, series: int) -> int:
        """Return how many instances a series lacks, as there was no room for them."""
        return int(
            self.value(f"SELECT count(*) FROM series JOIN lacking ON {OF_SERIES} WHERE series.id = ?", series)
        )

    def announce(self, series_uid: str, instances: int, now: float) -> None:
        """Note how many instances a series has, whether any of it is here yet or not."""
        self.run(
            "INSERT INTO announced VALUES (?, ?, ?) ON CONFLICT DO UPDATE SET instances = excluded.instances",
            *(series_uid, instances, now),
        )
        self.run("UPDATE series SET expected = ? WHERE series_uid = ?", instances, series_uid)

    def set_clock_back(self, now: float) -> None:
        """Take nothing for later than ``now``, nor for put off longer than anything is: a clock ahead noted it."""
        self.run("UPDATE series SET received = ? WHERE received > ?", now, now)
        for table in ("jobs", "deliveries", "commitments"):
            self.run(f"UPDATE {table} SET due = ? WHERE due > ?", now, now + LONGEST_WAIT_S)

    def open_series(self) -> list[SeriesRow]:
        """Return what is not complete, or was and got something new."""
        return self.records(SeriesRow, "FROM series WHERE complete < revision")

    def complete_series(self, quiet_since: float, missing_since: float) -> list[SeriesRow]:
        """Find what is complete and was not.

        That is what has as many instances as were announced, or got nothing new since a time: ``quiet_since``, or
        where some are known to be missing ``missing_since``.
        """
        return self.records(
            SeriesRow,
            "FROM series WHERE complete < revision AND (instances >= expected"
            " OR received <= CASE WHEN instances < expected"
            f" OR EXISTS (SELECT 1 FROM lacking WHERE {OF_SERIES}) THEN ? ELSE ? END)",
            missing_since,
            quiet_since,
        )
