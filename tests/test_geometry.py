"""Points that cannot be places in mm are refused before anything is computed with them."""

import numpy as np
import pytest

from ronnaplan.bounds import FARTHEST_POINT_MM
from ronnaplan.errors import InputError
from ronnaplan.geometry import as_points
from ronnaplan.registration import register_points
from tests.registration import scene


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ([[1 + 2j, 0, 0]], "complex"),
        (np.zeros((2, 3), dtype=complex), "complex"),
        (np.ma.masked_greater(np.eye(3), 0.5), "masked in part"),
        ([[0, 0, 0], [0, 1e300, 0]], "row 1.*millimetres"),
        ([[0, -1.01 * FARTHEST_POINT_MM, 0]], "row 0.*millimetres"),
        ([[0, 0, 10**400]], "not numbers"),
    ],
)
def test_what_is_no_place_in_mm_is_refused(values: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        as_points(values)  # type: ignore[arg-type]


def test_a_registration_neither_takes_nor_predicts_at_coordinates_beyond_reason() -> None:
    found = register_points(scene.HEAD, scene.HEAD @ scene.TURN.T + scene.SHIFT)
    with pytest.raises(InputError, match="millimetres"):
        found.tre([[1e300, 0, 0]])
    with pytest.raises(InputError, match="millimetres"):
        register_points(1e298 * scene.HEAD, scene.HEAD)
