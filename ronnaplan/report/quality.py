"""The quality report of a case: one page that says what was found and how far it can be trusted."""

from __future__ import annotations

from datetime import UTC, datetime

from ronnaplan import __version__
from ronnaplan.case.folder import Case
from ronnaplan.report.html import box, element, page, section, table
from ronnaplan.report.marker_part import markers_part
from ronnaplan.report.part import Part
from ronnaplan.report.path_part import paths_part
from ronnaplan.report.registration_part import registration_part
from ronnaplan.report.scan_part import scan_part

NOTICE = "Research software, not a medical device."


def quality_report(case: Case) -> str:
    """Return the report as one HTML page: warnings first, then scan, markers, trajectories, registration."""
    parts = [scan_part(case), markers_part(case), paths_part(case), registration_part(case)]
    return page(
        "Quality report",
        [
            element("h1", "Quality report"),
            element("p", f"ronnaplan {__version__}, {_now()}. {NOTICE}", "note"),
            _warnings(parts),
            *(section(part.title, part.body) for part in parts if part.body),
            section("Inputs", [table(["input", "SHA-256"], case.hashes)]),
        ],
    )


def _warnings(parts: list[Part]) -> str:
    warnings = list(dict.fromkeys(warning for part in parts for warning in part.warnings))
    if not warnings:
        return box("clear", "No warnings.", [])
    count = "1 warning" if len(warnings) == 1 else f"{len(warnings)} warnings"
    return box("warnings", count, warnings)


def _now() -> str:
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
