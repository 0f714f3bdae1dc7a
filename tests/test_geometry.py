"""Points that cannot be places in mm are refused before anything is computed with them."""

from typing import Any

import numpy as np
import pytest

from ronnaplan.bounds import FARTHEST_POINT_MM
from ronnaplan.correspondence import match_points
from ronnaplan.errors import InputError
from ronnaplan.geometry import as_points
from ronnaplan.pose import as_pose
from ronnaplan.registration import predict_tre, radius_95_mm, register_points
from ronnaplan.robot import calibrate_pivot
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


@pytest.mark.parametrize(
    ("wrong", "says"), [(1 + 0j, "complex"), (np.ma.masked, "masked in part"), ("a", "not numbers")]
)
def test_numbers_that_are_not_real_or_not_all_there_are_refused_wherever_they_stand(wrong: Any, says: str) -> None:
    """What lies beneath a mask counted, and of complex numbers the real part, with a warning."""
    errors: Any = np.ma.array(np.tile(np.eye(3), (6, 1, 1)))
    pose: Any = np.ma.array(np.eye(4))
    if wrong is not np.ma.masked:
        errors, pose = (np.asarray(values.astype(type(wrong))) for values in (errors, pose))
    errors[0, 0, 0] = pose[0, 3] = wrong
    for refuse in (
        lambda: register_points(scene.HEAD, scene.HEAD, errors),
        lambda: predict_tre(scene.HEAD, errors, scene.HEAD),
        lambda: radius_95_mm(errors),
        lambda: match_points(scene.HEAD, scene.HEAD, covariances_ct_mm2=errors),
        lambda: match_points(scene.HEAD, scene.HEAD, sigma_ots_mm=errors[:, 0, 0]),
        lambda: as_pose(pose),
        lambda: calibrate_pivot([pose] * 10 if isinstance(wrong, str) else np.ma.stack([pose] * 10)),
    ):
        with pytest.raises(InputError, match=says):
            refuse()


def test_a_registration_neither_takes_nor_predicts_at_coordinates_beyond_reason() -> None:
    found = register_points(scene.HEAD, scene.HEAD @ scene.TURN.T + scene.SHIFT)
    with pytest.raises(InputError, match="millimetres"):
        found.tre([[1e300, 0, 0]])
    with pytest.raises(InputError, match="millimetres"):
        register_points(1e298 * scene.HEAD, scene.HEAD)
