"""The page shows what is worst first, charts what drifts, and opens without anything else."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from PIL import Image

from ronnaplan.cohort import page as page_module
from ronnaplan.cohort.index import Index
from ronnaplan.cohort.listing import bring_up_to_date
from ronnaplan.cohort.page import write_page
from ronnaplan.cohort.summary import WORST, summarize
from tests.faults import shut


def rows(out: Path) -> list[dict[str, Any]]:
    """A cohort of two scanners; one drifts, the other scans patients, of whom some are refused."""
    random = np.random.default_rng(5)
    sheet = io.BytesIO()
    Image.new("RGB", (1200, 300), "white").save(sheet, "PNG")
    (out / "sheet.png").write_bytes(sheet.getvalue())
    shared = {"root": "/in", "archive": "", "manufacturer": "Maker", "sheet": "sheet.png", "thickness_mm": 0.6}
    days = [{**shared, **day_of_a_phantom(random, day)} for day in range(120)]
    return [*days, *({**shared, **patient(random, number)} for number in range(30))]


def day_of_a_phantom(random: np.random.Generator, day: int) -> dict[str, Any]:
    """A phantom's scan, on a scanner that drifts from the 60th day on."""
    drift_mm = 0.001 * max(day - 60, 0)
    return {
        **{"series": f"1.{day}", "folder": f"qa/{day}", "state": "done", "reason": "", "model": "A"},
        **{"found": 6, "expected": 6, "error_rms_mm": 0.004, "misfit": 0.02, "rejected": ["round"]},
        "phantom": "daily",
        "phantom_reasons": ["it is stretched"] * (day == 119),
        "acquired": f"2026-{1 + day // 28:02d}-{1 + day % 28:02d}",
        "distance_mean_mm": 0.01 * random.standard_normal() + drift_mm,
        "distance_rms_mm": 0.02 + 0.002 * random.standard_normal(),
    }


def patient(random: np.random.Generator, number: int) -> dict[str, Any]:
    """A patient's scan; in one of them a marker is missing."""
    count = 5 if number == 7 else 6
    return {
        **{"series": f"2.{number}", "folder": f"p<b>/{number}", "model": "B", "found": count, "expected": 6},
        "state": "done" if count == 6 else "refused",
        "reason": "" if count == 6 else "5 markers, not 6",
        **{"error_rms_mm": 0.01 * (1 + random.random()), "misfit": 0.03 + 0.001 * number, "rejected": []},
    }


def test_the_page_tells_the_drift_and_shows_the_worst_sheet_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = rows(tmp_path)
    summary = summarize(given)
    worst = summary.worst_first
    assert len(worst) == WORST
    assert [one["series"] for one in worst[:3]] == ["2.7", "1.119", "2.29"]
    first, *_ = summary.charts
    assert "drifts since" in first.verdict
    assert first.quantity.startswith("mean")
    assert summary.counts == {(6, 6): 149, (6, 5): 1}
    monkeypatch.setattr(page_module, "series_rows", lambda _: iter(given))
    with Index(tmp_path) as index:
        write_page(index, tmp_path)
    text = (tmp_path / "index.html").read_text()
    assert "drifts since 2026" in text
    assert re.search(r"A change in [12] of 2 charts", text)
    assert "p&lt;b&gt;/7" in text
    assert "6 of 6 markers; it is stretched" in text
    assert "<b>" not in text
    sources = re.findall(r'(?:src|href)="([^"]{0,40})', text)
    assert {one.partition(":")[0] for one in sources} == {"data", "series.parquet", "markers.parquet", "sheet.png"}


def test_a_phantom_that_was_scanned_too_rarely_for_a_chart_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_module, "series_rows", lambda _: iter(rows(tmp_path)[:5]))
    with Index(tmp_path) as index:
        write_page(index, tmp_path)
    assert "too few for a chart, which takes 8: Maker A, daily: 5." in (tmp_path / "index.html").read_text()


def test_scans_of_a_phantom_whose_day_is_not_told_are_in_no_chart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They have no order; before the others they would set the limits, and a drift would have no day."""
    days = rows(tmp_path)[:120]
    undated = [{**one, "acquired": None} for one in days[-30:]]
    charts, alone = summarize([*undated, *days[:90]]).charts, summarize(days[:90]).charts
    assert [one.days for one in charts] == [one.days for one in alone]
    assert [one.verdict for one in charts] == [one.verdict for one in alone]
    monkeypatch.setattr(page_module, "series_rows", lambda _: iter(undated))
    with Index(tmp_path) as index:
        write_page(index, tmp_path)
    text = (tmp_path / "index.html").read_text()
    assert "Scans of phantoms that tell no day, and are in no chart: Maker A, daily: 30." in text
    assert "drifts" not in text


def test_scans_of_one_day_are_charted_in_the_order_of_their_times(tmp_path: Path) -> None:
    """Three a day, whose series come in the order of their UIDs."""
    days = rows(tmp_path)[:120]
    for number, one in enumerate(days):
        one |= {"acquired": f"2026-01-{1 + number // 3:02d}", "acquired_time": f"{7 + number % 3:02d}:30:00"}
    shuffled = sorted(
        days, key=lambda one: (one["acquired"], one["acquired_time"][::-1], -one["misfit"]), reverse=True
    )
    alone, charts = summarize(days).charts, summarize(shuffled).charts
    assert [one.values.tolist() for one in charts] == [one.values.tolist() for one in alone]
    earlier = [{name: value for name, value in one.items() if name != "acquired_time"} for one in days]
    assert summarize(earlier).charts  # what an index of before does not hold


def test_a_copy_of_a_scan_in_another_root_or_archive_is_charted_once(tmp_path: Path) -> None:
    """Each day twice would halve what the scans seem to scatter, and have every scanner flagged."""
    days = rows(tmp_path)[:60]
    copies = [{**one, "root": "/backup"} for one in days]
    alone, charts = summarize(days).charts, summarize([*days, *copies]).charts
    assert [one.values.tolist() for one in charts] == [one.values.tolist() for one in alone]


def test_a_cohort_without_series_has_a_page(tmp_path: Path) -> None:
    with Index(tmp_path) as index:
        write_page(index, tmp_path)
    assert "Research software" in (tmp_path / "index.html").read_text()


def test_the_page_tells_which_files_could_not_be_read(tmp_path: Path) -> None:
    (tmp_path / "in" / "a").mkdir(parents=True)
    (tmp_path / "in" / "a" / "x.zip").write_bytes(b"PK\x03\x04 and no more")
    (tmp_path / "in" / "a" / "note.txt").write_text("no scan")
    for number in range(20):
        (tmp_path / "in" / f"{number:02d}.dcm").touch()
    out = tmp_path / "out"
    out.mkdir()
    with Index(out) as index:
        bring_up_to_date(index, [str(tmp_path / "in")])
        write_page(index, out)
    text = (out / "index.html").read_text()
    assert "21 files or folders could not be read, the first 15 of them" in text
    assert "00.dcm: it is not a DICOM file" in text
    assert "note.txt" not in text
    assert "19.dcm: " not in text


def test_the_page_tells_of_folders_that_could_not_be_opened_and_of_a_root_that_is_empty_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, out = tmp_path / "in", tmp_path / "out"
    (root / "heads" / "shut").mkdir(parents=True)
    (root / "note.txt").write_text("no scan")
    out.mkdir()
    with Index(out) as index:
        with monkeypatch.context() as patched:
            shut(patched, "shut")
            bring_up_to_date(index, [str(root)])
        write_page(index, out)
        text = (out / "index.html").read_text()
        assert "1 file or folder could not be read" in text
        assert "heads/shut: the folder cannot be opened (Permission denied)" in text
        root.rename(tmp_path / "unmounted")
        root.mkdir()
        bring_up_to_date(index, [str(root)])
        write_page(index, out)
    assert f"{root}: it is empty, and was not; is its disk there?" in (out / "index.html").read_text()


def test_the_page_tells_of_an_archive_within_an_archive(tmp_path: Path) -> None:
    out, outer = tmp_path / "out", tmp_path / "outer.zip"
    out.mkdir()
    with ZipFile(outer, "w") as archive:
        archive.writestr("inner.zip", b"PK\x03\x04")
    with Index(out) as index:
        bring_up_to_date(index, [str(outer)])
        write_page(index, out)
    assert "outer.zip/inner.zip: an archive within an archive is not unpacked" in (out / "index.html").read_text()
