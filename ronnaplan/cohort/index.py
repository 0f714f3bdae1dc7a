"""The index of a cohort: every file and series below its roots, and what became of each series."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ronnaplan.cohort.places import Place
from ronnaplan.jobs.database import Database

FILE = "index.sqlite"
WAITING, DONE, ASIDE, LEFT = "waiting", "done", "aside", "left"
"""States of a series that was looked at (``new`` before): to be worked on, worked on, set aside by a fault, left alone
as no rule fits."""

SCHEMA = """
CREATE TABLE IF NOT EXISTS places (
    id INTEGER PRIMARY KEY, root TEXT NOT NULL, archive TEXT NOT NULL DEFAULT '', UNIQUE (root, archive)
);
CREATE TABLE IF NOT EXISTS series (
    id INTEGER PRIMARY KEY, place INTEGER NOT NULL REFERENCES places (id) ON DELETE CASCADE,
    study_uid TEXT NOT NULL, series_uid TEXT NOT NULL,
    modality TEXT NOT NULL, description TEXT NOT NULL, protocol TEXT NOT NULL, station TEXT NOT NULL,
    study TEXT NOT NULL, device TEXT NOT NULL, folder TEXT NOT NULL,
    revision INTEGER NOT NULL DEFAULT 0,     -- grows with every change of its files
    state TEXT NOT NULL DEFAULT 'new', rule TEXT NOT NULL DEFAULT '', reason TEXT NOT NULL DEFAULT '',
    attempts INTEGER NOT NULL DEFAULT 0,
    worked_revision INTEGER, worked_settings TEXT,  -- what the results are of
    seconds REAL, peak_bytes INTEGER,
    UNIQUE (place, study_uid, series_uid)
);
CREATE INDEX IF NOT EXISTS series_by_state ON series (state, id);
CREATE TABLE IF NOT EXISTS files (
    place INTEGER NOT NULL REFERENCES places (id) ON DELETE CASCADE,
    folder TEXT NOT NULL, name TEXT NOT NULL, size INTEGER NOT NULL, stamp TEXT NOT NULL,
    series INTEGER REFERENCES series (id), archive INTEGER REFERENCES places (id),
    trouble INTEGER NOT NULL DEFAULT 0, reason TEXT NOT NULL DEFAULT '',
    PRIMARY KEY (place, folder, name)
) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS files_of_series ON files (series);
CREATE INDEX IF NOT EXISTS files_archives ON files (archive) WHERE archive IS NOT NULL;
CREATE TABLE IF NOT EXISTS parts (           -- the stacks that a series falls into
    series INTEGER NOT NULL REFERENCES series (id) ON DELETE CASCADE, number INTEGER NOT NULL,
    key TEXT NOT NULL, state TEXT NOT NULL, reason TEXT NOT NULL, content TEXT NOT NULL,
    found INTEGER, expected INTEGER,
    scan TEXT NOT NULL, markers TEXT NOT NULL, rejected TEXT NOT NULL, checked TEXT NOT NULL,  -- JSON
    fiducials TEXT NOT NULL, sheet TEXT NOT NULL,   -- paths below the cohort's folder
    PRIMARY KEY (series, number)
) WITHOUT ROWID;
"""

TEXTS = ("modality", "description", "protocol", "station", "study", "device", "folder")
"""What is known of a series before it is worked on; rules look at it."""


@dataclass(frozen=True)
class SeriesRow:
    """A series as the index knows it."""

    id: int
    place: int
    study_uid: str
    series_uid: str
    modality: str
    description: str
    protocol: str
    station: str
    study: str
    device: str
    folder: str
    revision: int
    state: str
    rule: str
    reason: str
    attempts: int
    worked_revision: int | None
    worked_settings: str | None


class Index(Database):
    """One connection to the index of the cohort kept in ``folder``; one thread at a time uses it."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / FILE, SCHEMA)
        self.folder = folder

    def place(self, place: Place) -> int:
        """Return the number of a place, which is entered if it is new."""
        self.run(
            "INSERT INTO places (root, archive) VALUES (?, ?) ON CONFLICT DO NOTHING", place.root, place.archive
        )
        number: int = self.value("SELECT id FROM places WHERE root = ? AND archive = ?", place.root, place.archive)
        return number

    def place_of(self, number: int) -> Place:
        """Return the place with this number."""
        (found,) = self.rows("SELECT root, archive FROM places WHERE id = ?", number)
        return Place(*found)

    def left_out(self, root: str, reason: str) -> list[tuple[str, str]]:
        """Return the members (archive, path in it) of a root's archives that were not looked into for ``reason``."""
        found = self.rows(
            "SELECT places.archive, ltrim(folder || '/' || name, '/') FROM files JOIN places ON places.id = place"
            " WHERE root = ? AND places.archive != '' AND reason = ? ORDER BY place, folder, name",
            *(root, reason),
        )
        return [(archive, member) for archive, member in found]

    def count(self, state: str) -> int:
        """Return how many series are in ``state``."""
        number: int = self.value("SELECT COUNT(*) FROM series WHERE state = ?", state)
        return number
