"""The quality report of a case: one page that says what was found and how far it can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

from ronnaplan import __version__
from ronnaplan.case.folder import Case
from ronnaplan.report import marker_part, overview, path_part
from ronnaplan.report.html import Part, box, element, html_of, page, section, table
from ronnaplan.report.marker_part import markers_part
from ronnaplan.report.overview import View, overview_part
from ronnaplan.report.path_part import paths_part
from ronnaplan.report.placement_part import placement_part
from ronnaplan.report.registration_part import registration_part
from ronnaplan.report.scan_part import scan_part
from ronnaplan.text import NOTICE, counted

Paper = Literal["A4", "Letter"]

SIGNERS = ("planned by", "checked by")
SIGNATURE = ("", "name", "date", "signature")
STYLE = ".signatures td, .signatures th { height: 2.6rem; min-width: 9rem; vertical-align: bottom }"


def quality_report(
    case: Case, name: str = "", seen: View | None = None, *, turns: bool = True, paper: Paper = "A4"
) -> str:
    """Return the report as one HTML page: warnings and overview first, then scan, markers, trajectories, registration.

    ``name`` is what the case is called. ``seen`` is its head in 3-D, which can be turned where the page ``turns`` it;
    printed, its pages are ``paper``.
    """
    return drafted(case, name, seen, turns=turns, paper=paper)()


def drafted(
    case: Case, name: str = "", seen: View | None = None, *, turns: bool = True, paper: Paper = "A4"
) -> Draft:
    """Gather all that the report says of the scan; return what draws and writes it, and holds no voxels."""
    parts = [
        overview_part(case, seen, turns=turns),
        scan_part(case),
        markers_part(case),
        paths_part(case),
        registration_part(case),
        placement_part(case, seen),
    ]
    title, made = (f"Quality report: {name}" if name else "Quality report"), f"ronnaplan {__version__}, {_now()}"
    return Draft(
        title,
        made,
        parts,
        _end(case),
        _sheet(paper, f"{title}, {made}. {NOTICE}"),
        overview.script(seen) if turns else "",
    )


@dataclass(frozen=True)
class Draft:
    """All that a report says, to be drawn and written when it is called; another process can do that."""

    title: str
    made: str
    parts: Sequence[Part]
    end: str
    sheet: str
    script: str

    def __call__(self) -> str:
        """Return the report as one HTML page."""
        return page(
            self.title,
            [
                element("h1", self.title),
                element("p", f"{self.made}. {NOTICE}", "note"),
                _warnings(self.parts),
                *(section(part.title, html_of(part.body)) for part in self.parts if part.body),
                self.end,
            ],
            style="".join((self.sheet, STYLE, overview.STYLE, marker_part.STYLE, path_part.STYLE)),
            script=self.script,
        )


def _warnings(parts: Sequence[Part]) -> str:
    warnings = list(dict.fromkeys(warning for part in parts for warning in part.warnings))
    if not warnings:
        return box("clear", "No warnings.", [])
    return box("warnings", counted(len(warnings), "warning"), warnings)


def _end(case: Case) -> str:
    """Return what is signed for and room for the signatures, on one page: they never stand alone."""
    inputs = section("Inputs", [table(["input", "SHA-256"], case.hashes)])
    rows = [(who, "", "", "") for who in SIGNERS]
    signed = f'<div class="signatures">{element("h2", "Signatures")}{table(SIGNATURE, rows)}</div>'
    return f'<div class="whole">{inputs}{signed}</div>'


def _sheet(paper: Paper, footer: str) -> str:
    """Return the style of printed pages: their size, and at the foot of each what it belongs to and its number."""
    told = "".join(letter if letter.isalnum() else f"\\{ord(letter):06x}" for letter in footer)
    look = "font: 8pt system-ui, sans-serif; color: #4a5a6a"
    left, right = f'content: "{told}"', 'content: "page " counter(page) " of " counter(pages)'
    return (
        f"@page {{ size: {paper}; margin: 14mm 15mm 18mm; "
        f"@bottom-left {{ {left}; {look}; width: 85% }} @bottom-right {{ {right}; {look} }} }}"
    )


def _now() -> str:
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
