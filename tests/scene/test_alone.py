"""What a head lies on is not drawn; what belongs to it is: posts with their markers, the walls of a hollow one."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.geometry import FloatArray
from ronnaplan.scene.alone import alone
from ronnaplan.scene.field import Field

CELL_MM = 2.0
SIZE = 100
Z, Y, X = np.meshgrid(*(CELL_MM * np.arange(SIZE),) * 3, indexing="ij")
AWAY_MM = np.sqrt((Z - 100) ** 2 + (Y - 90) ** 2 + (X - 100) ** 2)
FROM_AXIS_MM = np.hypot(Y - 90, X - 100)

REST = (FROM_AXIS_MM > 78) & (FROM_AXIS_MM < 83) & (Y > 90)
"""Half a pipe about the head."""
STRAPS = (np.abs(Z - 100) < 4) & (np.abs(Y - 100) < 4) & (FROM_AXIS_MM < 80)
"""By which it touches the head at both ends."""
POST = (np.abs(Z - 100) < 3) & (np.abs(X - 100) < 3) & (Y > 10) & (Y < 30)
MARKER = np.sqrt((Z - 100) ** 2 + (Y - 10) ** 2 + (X - 100) ** 2) < 6
TABLE = Y > 190
HEAD, WALLS = AWAY_MM < 65, (AWAY_MM < 65) & (AWAY_MM > 61)


def field(*parts: np.ndarray) -> Field:
    values: FloatArray = np.where(np.any(parts, axis=0), 100.0, LOWEST_HU)
    return Field(values.astype(np.float32), np.zeros(3), CELL_MM)


def dense(shown: Field) -> np.ndarray:
    return shown.values > -400.0


@pytest.mark.parametrize("head", [HEAD, WALLS], ids=["solid", "hollow"])
def test_a_head_is_kept_with_its_post_and_marker_without_what_it_lies_near(head: np.ndarray) -> None:
    np.testing.assert_array_equal(dense(alone(field(head, POST, MARKER, REST, TABLE))), head | POST | MARKER)


def test_a_rest_that_touches_the_head_at_both_ends_goes_and_the_head_stays_whole() -> None:
    found = dense(alone(field(HEAD, POST, MARKER, REST, STRAPS)))
    assert found[HEAD | POST | MARKER].all()
    assert found[REST & ~STRAPS].mean() < 0.01


def test_a_scan_stays_as_it_is_where_there_is_no_body_or_none_that_is_surely_the_head() -> None:
    for parts in ([MARKER & (Z == 100)], [WALLS, (Y > 180) & (Z > 40) & (X > 40)]):
        scan = field(*parts)
        assert alone(scan) is scan
