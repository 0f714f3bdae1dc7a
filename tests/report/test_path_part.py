"""Beside a trajectory of many the nearest others are listed, and what is wrong with two is warned of once."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.case.folder import Case, CaseFiles, read_case
from ronnaplan.planning import Limits
from ronnaplan.report import path_part
from ronnaplan.report.html import html_of
from ronnaplan.report.path_part import NEAREST, paths_part
from tests import cases

APART_MM = 0.5


@pytest.fixture(autouse=True)
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cuts are not drawn: they say nothing of what is tested."""
    monkeypatch.setattr(path_part, "path_picture", lambda *_: b"")


def in_a_row(folder: Path, shifts_mm: Sequence[float], limits: Limits) -> Case:
    """A case of trajectories beside each other, shifted so far from the first; 1 mm thick each."""
    case = read_case(CaseFiles.of_folder(cases.write_case(folder)), cases.volume)
    assert case.plan is not None
    left = case.plan.trajectory("left")
    aside = np.cross(left.inward, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    paths = tuple(
        replace(left, name=f"E{n}", entry_mm=left.entry_mm + mm * aside, target_mm=left.target_mm + mm * aside)
        for n, mm in enumerate(shifts_mm)
    )
    return replace(case, plan=replace(case.plan, trajectories=paths), rules=replace(case.rules, limits=limits))


def rows_of_first(case: Case) -> list[list[str]]:
    """The rows of the first trajectory's tables that tell distances to others."""
    first = next(piece for piece in html_of(paths_part(case).body) if "<h3>" in piece)
    rows = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", first)]
    return [row for row in rows if re.match(r"distance to (E\d+|\d+ others)$", row[0])]


def test_of_many_the_nearest_are_listed_and_how_near_the_others_come_at_least(tmp_path: Path) -> None:
    """A plan of hundreds would print hundreds of rows beside each of its trajectories."""
    count = NEAREST + 5
    shifts_mm = [0.0, *(3.0 + APART_MM * n for n in reversed(range(count)))]
    limited = in_a_row(tmp_path, shifts_mm, Limits(least_trajectory_distance_mm=1.0))
    *each, (called, value, limit, verdict, remark) = rows_of_first(limited)
    assert [row[0] for row in each] == [f"distance to E{n}" for n in range(count - NEAREST + 1, count + 1)]
    nearest_mm = shifts_mm[count - NEAREST] - 1.0
    assert (called, value, limit, verdict) == ("distance to 5 others", f"{nearest_mm:.2f}", "1.00 mm", "pass")
    assert remark == "the nearest of them"
    unjudged = replace(
        limited, fiducials=None, rules=replace(limited.rules, limits=Limits(least_marker_distance_mm=1))
    )
    *each_too, last = rows_of_first(unjudged)
    assert [row[0] for row in each_too] == [row[0] for row in each]
    assert last == ["distance to 5 others", f"{nearest_mm:.2f} mm, the nearest of them"]


def test_beside_few_others_each_is_listed_and_so_is_each_that_is_too_near_or_nearly_so(tmp_path: Path) -> None:
    limits = Limits(least_trajectory_distance_mm=20.0)
    few = in_a_row(tmp_path, [0.0, *(3.0 + APART_MM * n for n in range(NEAREST + 1))], Limits())
    assert [row[0] for row in rows_of_first(few)] == [f"distance to E{n}" for n in range(1, NEAREST + 2)]
    clearances_mm = [*np.linspace(4.0, 18.0, NEAREST + 3), 21.0, 21.5, 23.0, 24.0]
    case = in_a_row(tmp_path, [0.0, *(mm + 1.0 for mm in clearances_mm)], limits)
    *each, last = rows_of_first(case)
    assert [row[0] for row in each] == [f"distance to E{n}" for n in range(1, NEAREST + 6)]
    assert last[:2] == ["distance to 2 others", "23.00"]


def test_two_that_come_too_near_to_each_other_are_warned_of_once(tmp_path: Path) -> None:
    case = in_a_row(tmp_path, [0.0, 1.5, 6.0], Limits(least_trajectory_distance_mm=1.0, longest_path_mm=20.0))
    part = paths_part(case)
    between = [one for one in part.warnings if "distance to E" in one]
    assert [one.split(" at depth ")[0] for one in between] == [
        "trajectory E0: distance to E1 0.50 mm (limit 1.00)"
    ]
    assert sum("path length" in one for one in part.warnings) == 3
    assert "".join(html_of(part.body)).count('<td class="fail">FAIL</td>') == 5
