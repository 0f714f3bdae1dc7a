"""A page of HTML in titled parts, from texts, tables and pictures. Every text is escaped, and nothing is fetched."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from urllib.parse import quote

from ronnaplan.text import ISOLATE, ISOLATE_END

STYLE = """
body { font: 14px/1.45 system-ui, sans-serif; color: #1c2733; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
  overflow-wrap: break-word }
h1 { font-size: 1.6rem; margin-bottom: 0 } h2 { margin-top: 2rem; border-bottom: 1px solid #c8d2dc }
h3 { margin-bottom: .3rem } h1, h2, h3 { break-after: avoid }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums }
th, td { text-align: left; padding: .15rem .9rem .15rem 0; border-bottom: 1px solid #e4e9ee; vertical-align: top }
th { font-weight: 600; color: #4a5a6a } td { white-space: nowrap }
td:first-child, td.text, td.long { white-space: normal } td.long { overflow-wrap: anywhere }
figure { margin: .6rem 0 } figure img { max-width: 100% } figcaption { color: #4a5a6a }
.warnings { background: #fff3e0; border-left: 5px solid #e07b00; padding: .4rem 1rem; margin: 1rem 0 }
.clear { background: #eaf5ea; border-left: 5px solid #3d8b40; padding: .4rem 1rem; margin: 1rem 0 }
.fail { color: #b3261e; font-weight: 600 } .note { color: #4a5a6a }
@media screen { table { display: block; overflow-x: auto } }
@media print {
  body { font-size: 9.5pt; margin: 0; max-width: none; padding: 0; print-color-adjust: exact }
  h2 { margin-top: 1rem } th, td { padding: .1rem .7rem .1rem 0 }
  figure, table, tr, .whole, section:not(:has(figure)) { break-inside: avoid }
}
"""

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""Told to the browser: this page loads nothing, and runs nothing but what is named after it."""

LETTER = "[\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufefe\U00010800-\U00010fff\U0001e800-\U0001efff]"
BETWEEN = "[-_ ./'\"0-9]"
INSIDE = rf"(?:{LETTER}|{BETWEEN})"
RIGHT_TO_LEFT = re.compile(
    rf"(?:{LETTER}|[(\[]{LETTER}{INSIDE}*[)\]])(?:{BETWEEN}*(?:{LETTER}|[(\[]{INSIDE}+[)\]]))*"
)
"""A name in Hebrew or Arabic, its words, what it has in brackets, and marks and numbers between them together, stands
apart: else a browser writes the number behind it before it, and its sign last."""

ISOLATED = re.compile(f"({ISOLATE}[^{ISOLATE_END}]*{ISOLATE_END})")
"""A name of `isolated`, which a browser keeps whole by itself, whatever is in it."""

LONGEST_WORD = 30
"""A word that is longer (a UID, a hash) may be broken anywhere, no other: a number stays whole."""

LONGEST_VALUE = 24
"""A cell with no more letters stands in one line, unless it is a row's first: numbers stay whole, with their unit."""


def page(title: str, body: Iterable[str], *, style: str = "", script: str = "") -> str:
    """Return a whole document that needs no other file; ``script`` is the only one that its browser runs."""
    hashed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy, run = (
        (f"{POLICY}; script-src 'sha256-{hashed}'", f"<script>{script}</script>") if script else (POLICY, "")
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        f"<title>{escape(title)}</title><style>{STYLE}{style}</style></head>\n<body><main>\n"
        + "\n".join(body)
        + f"\n</main>{run}</body></html>\n"
    )


def element(tag: str, text: str, css: str = "") -> str:
    """Return one element that holds ``text``."""
    name = f' class="{escape(css)}"' if css else ""
    parts = ISOLATED.split(escape(text, quote=False))
    parts[::2] = [RIGHT_TO_LEFT.sub(r"<bdi>\g<0></bdi>", part) for part in parts[::2]]
    apart = "".join(parts)
    return f"<{tag}{name}>{apart}</{tag}>"


def section(title: str, body: Iterable[str]) -> str:
    """Return a section under its heading; ``body`` is HTML."""
    return f"<section>{element('h2', title)}\n" + "\n".join(body) + "\n</section>"


def box(css: str, heading: str, items: Sequence[str]) -> str:
    """Return a coloured box with a list of texts."""
    listed = f"<ul>{''.join(element('li', item) for item in items)}</ul>" if items else ""
    return f'<div class="{escape(css)}"><p>{element("strong", heading)}</p>{listed}</div>'


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of texts; without a header its first column names the rows."""
    named = "".join(element("th" if cell else "td", cell) for cell in header)  # no header that says nothing
    top = f"<thead><tr>{named}</tr></thead>" if header else ""
    first = "td" if header else "th"
    body = "".join(
        f"<tr>{element(first, name, _broken(name))}{''.join(element('td', cell, _css(cell)) for cell in cells)}</tr>"
        for name, *cells in rows
    )
    return f"<table>{top}{body}</table>"


def unseen(name: str, text: str) -> str:
    """Return an element ``name`` that no reader sees: what is on the page, for programs that read it."""
    return f'<div id="{escape(name, quote=True)}" hidden>{escape(text, quote=False)}</div>'


def link(path: str, text: str) -> str:
    """Return a link to a file beside the page."""
    return f'<a href="{escape(quote(path), quote=True)}">{escape(text)}</a>'


def picture(image: bytes, caption: str, kind: str = "png") -> str:
    """Return a picture of this ``kind`` (png, jpeg) that is part of the page, with its caption."""
    data = base64.b64encode(image).decode()
    shown = f'<img src="data:image/{kind};base64,{data}" alt="{escape(caption, quote=True)}">'
    return f"<figure>{shown}{element('figcaption', caption)}</figure>"


Piece = str | Callable[[], str]
"""A piece of HTML, or what draws it when the page is written: then the scan may be gone."""


def html_of(pieces: Iterable[Piece]) -> list[str]:
    """Return the HTML of pieces, drawn now."""
    return [piece if isinstance(piece, str) else piece() for piece in pieces]


@dataclass(frozen=True)
class Part:
    """A titled part: ``body`` holds pieces and may be empty; ``warnings`` are texts that go to the top of the page."""

    title: str
    body: Sequence[Piece] = ()
    warnings: list[str] = field(default_factory=list)


def _css(cell: str) -> str:
    if cell.startswith(("FAIL", "not judged")):
        return "fail"
    return _broken(cell) or ("text" if len(cell) > LONGEST_VALUE else "")


def _broken(cell: str) -> str:
    return "long" if max(map(len, cell.split()), default=0) > LONGEST_WORD else ""
