"""Every row of the tables of promises, and of what is read, names tests that there are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
DOCS = TESTS.parent / "docs"
HOMES = {"promises.md": TESTS, "reading.md": TESTS / "ct"}
"""Page -> where the modules lie whose folder it leaves out."""
NAMED = re.compile(r"`([\w/]+?)(?:\.py)?(?:::(\w+))?`(?:: ([^`|]*))?")
LEFT_TO_LONG_RUNS = re.compile(r"^@pytest\.mark\.long\n(?:[@ )].*\n)*def \w+", re.MULTILINE)
"""The name of a test that no run of all tests runs: it holds no promise by itself."""
OTHERS = ("doctest", "every border")
"""What else may hold a promise."""


def cells(page: str) -> list[str]:
    """Return what stands under "test" in each row of the page's tables."""
    found, column = [], -1
    for line in (DOCS / page).read_text(encoding="utf-8").splitlines():
        row = [cell.strip() for cell in line.split("|")[1:-1]]
        if not row:
            column = -1
        elif column < 0:
            column = [cell.lower() for cell in row].index("test") if "test" in line.lower() else len(row)
        elif column < len(row) and set(row[0]) != {"-"}:
            found.append(row[column])
    return found


def names_in(name: str, home: Path) -> list[str]:
    """Return the names of the tests in the module, or folder of modules, that a page calls ``name``."""
    path = Path(name.removeprefix("tests/"))
    near = [base / path.with_suffix(".py") for base in (TESTS, home)]
    files = [each for each in near if each.is_file()] or list((TESTS / path).glob("*.py"))
    files = files or [each for each in TESTS.rglob(f"{path.name}.py") if not path.parent.name]
    texts = [LEFT_TO_LONG_RUNS.sub("", each.read_text(encoding="utf-8")) for each in files]
    return [one for text in texts for one in re.findall(r"(?:def|class) (\w+)", text)]


@pytest.mark.parametrize("page", HOMES)
def test_each_row_names_tests_that_there_are(page: str) -> None:
    rows = cells(page)
    assert len(rows) > 30
    wrong = []
    for cell in rows:
        if any(other in cell for other in OTHERS):
            continue
        named = NAMED.findall(cell)
        if not named:
            wrong.append(f"no test: {cell}")
        for name, function, phrases in named:
            known = names_in(name, HOMES[page])
            told = [function] if function else [each.strip() for each in re.split("[,;]", phrases) if each.strip()]
            for phrase in told or [""]:
                words = [phrase] if function else re.findall(r"[a-z0-9]{3,}", phrase.lower())
                if not any(all(word in one.lower() for word in words) for one in known):
                    wrong.append(f"{name}: {phrase}")
    assert not wrong, "\n".join(wrong)
