"""Rows of 4 x 4 matrices are poses."""

from pathlib import Path

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.tracking import read_recording
from tests.tracking.files import matrix_rows, turned, written


@pytest.mark.parametrize(("first", "rows"), [(0, 4), (0, 3), (1, 4)])
def test_rows_of_matrices_are_poses(tmp_path: Path, first: int, rows: int) -> None:
    recording = read_recording(written(tmp_path, "poses.csv", matrix_rows(first, rows)))
    np.testing.assert_allclose(recording.poses("tool"), [turned(k) for k in range(3)], atol=1e-12)
    assert [tool.frame for tool in recording.tools] == [0, 1, 2]
    assert recording.tools[1].time_s == pytest.approx(1378476417.9227552, abs=1e-6)
    assert recording.notes == ()


def test_matrices_by_columns_are_flagged_not_turned_round(tmp_path: Path) -> None:
    names = ",".join(f"m{r}{c}" for r in range(4) for c in range(4))
    numbers = ",".join(map(repr, turned(1).T.ravel().tolist()))
    (tool,) = read_recording(written(tmp_path, "poses.csv", f"{names}\n{numbers}\n")).tools
    assert "is it transposed" in tool.status


@pytest.mark.parametrize(("first", "column"), [(0, "m12"), (1, "m11")])
def test_a_column_that_a_matrix_lacks_is_named(tmp_path: Path, first: int, column: str) -> None:
    without = matrix_rows(first, 3).replace(f",{column}", ",other")
    with pytest.raises(InputError, match=f"but no {column}; expected all of a matrix"):
        read_recording(written(tmp_path, "poses.csv", without))


def test_matrices_are_counted_where_their_moments_have_no_numbers(tmp_path: Path) -> None:
    rows = matrix_rows(0, 4)
    assert not read_recording(written(tmp_path, "m.csv", rows)).numbered
    assert read_recording(
        written(tmp_path, "n.csv", "frame,m" + rows.split(",m", 1)[1].replace("13784764", ""))
    ).numbered


def test_poses_of_several_tools_without_numbers_are_counted_for_each(tmp_path: Path) -> None:
    header, *rows = matrix_rows(0, 4).splitlines()
    text = "\n".join([f"tool,{header}", *(f"{name},{row}" for row in rows for name in "AB")])
    tools = read_recording(written(tmp_path, "m.csv", text)).tools
    assert [(tool.tool, tool.frame) for tool in tools] == [(name, k) for k in range(3) for name in "AB"]
