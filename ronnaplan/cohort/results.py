"""What became of a series, on the disk: its documents first, then the index; what is in the index is there."""

from __future__ import annotations

import base64
import hashlib
import json
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from ronnaplan.cohort.children import Outcome
from ronnaplan.cohort.index import ASIDE, DONE, Index, SeriesRow
from ronnaplan.cohort.places import Place
from ronnaplan.cohort.work import GONE, UNCHANGED, UNUSABLE
from ronnaplan.documents.files import make_folder, write_atomically
from ronnaplan.jobs.serving import BROKEN, REFUSED

SERIES: Final = "series"
"""The folder of the results of single series."""


def folder_of(series: SeriesRow, place: Place) -> str:
    """Return where the results of a series lie below the cohort's folder; the same in every run."""
    text = "\n".join([place.root, place.archive, series.study_uid, series.series_uid])
    name = hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()[:24]
    return f"{SERIES}/{name[:2]}/{name}"


def state_of(outcome: Outcome) -> str:
    """Return the state of the series that an order's outcome is of."""
    return ASIDE if outcome["state"] in (BROKEN, GONE) else DONE


def keep(index: Index, out: Path, series: SeriesRow, settings: str, outcome: Outcome) -> None:
    """Keep the outcome of a series, as it was when its order was made."""
    place = index.place_of(series.place)
    below = folder_of(series, place)
    state = state_of(outcome)
    parts = _parts(outcome)
    before = {
        row[0]: row[1:]
        for row in index.rows("SELECT key, fiducials, sheet FROM parts WHERE series = ?", series.id)
    }
    kept = [_write(out, below, part) for part in parts if part["state"] != UNCHANGED]
    with index.transaction():
        if state == DONE:
            keys = [part["key"] for part in parts if part["state"] == UNCHANGED]
            marks = ", ".join("?" * len(keys))
            index.run(f"DELETE FROM parts WHERE series = ? AND key NOT IN ({marks})", series.id, *keys)
        else:
            index.run("DELETE FROM parts WHERE series = ?", series.id)
        index.run_many(
            "INSERT OR REPLACE INTO parts VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            [(series.id, *row) for row in kept],
        )
        index.run(
            "UPDATE series SET state = ?, reason = ?, worked_revision = ?, worked_settings = ?, seconds = ?,"
            " peak_bytes = ? WHERE id = ?",
            *(state, outcome["reason"], series.revision, settings, outcome["seconds"], outcome["peak_bytes"]),
            series.id,
        )
    needed = set(index.rows("SELECT fiducials, sheet FROM parts WHERE series = ?", series.id))
    names = {name for row in needed for name in row}
    for name in {name for row in before.values() for name in row if name} - names:
        with suppress(OSError):
            (out / name).unlink()


def _parts(outcome: Outcome) -> list[dict[str, Any]]:
    """Return the parts; a series that was refused as a whole is one part."""
    if state_of(outcome) == ASIDE:
        return []
    if outcome["state"] == REFUSED:
        whole = {"number": 1, "key": "", "state": UNUSABLE, "reason": outcome["reason"], "content": "", "scan": {}}
        return [whole]
    parts: list[dict[str, Any]] = outcome["parts"]
    return parts


def _write(out: Path, below: str, part: dict[str, Any]) -> tuple[Any, ...]:
    """Write a part's documents; returns its row in the index, without the series."""
    end = "" if part["number"] == 1 else f"-{part['number']}"
    fiducials, sheet = part.get("fiducials"), part.get("sheet")
    names = ["", ""]
    if fiducials is not None:
        make_folder(out / below)
        names[0] = f"{below}/fiducials{end}.json"
        write_atomically(out / names[0], fiducials)
    if sheet is not None:
        names[1] = f"{below}/sheet{end}.png"
        write_atomically(out / names[1], base64.b64decode(sheet))
    told = (json.dumps(part.get(name, empty)) for name, empty in (("scan", {}), ("markers", []), ("rejected", [])))
    return (
        *(part["number"], part["key"], part["state"], part["reason"], part["content"]),
        *(part.get("found"), part.get("expected"), *told, json.dumps(part.get("checked")), *names),
    )
