"""The lights that may fall on a sphere, weighed by what its images tell of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.robot.stereo.lights import LOWERED, Lights, Sight, by_turning, in_each_light, weighed

FOCAL_PX, LAMP_SD_DEG = 4000.0, 0.04
TURNS = [np.eye(3), Rotation.from_rotvec([0, np.radians(-25), 0]).as_matrix()]
GAIN = 2e-3
"""By so much (on the plane at 1) a tilt that is not known of moves the center."""


def sight(turn: np.ndarray, uneven: np.ndarray, lens: tuple[float, float] = (0.0, 0.0)) -> Sight:
    """Return what a camera so turned sees of a ball whose brightness grows along ``uneven`` (3,), in the rig's frame.

    Tilt and light from aside are known to 0.01, and what they err by moves the center. So much tilt the ``lens`` makes.
    """
    across = turn[:, :2]
    errs = np.diag([1e-5] * 3 + [0.01] * 6)
    errs[:2, 3:5] = errs[:2, 5:7] = 0.01 * GAIN * np.eye(2)
    light, by_lamp = np.concatenate([across.T @ uneven, np.zeros(4)]), np.diag([1.0, 0.0])
    place = np.array([0, 0, 0.02])
    return Sight(turn[:, 2], across, place, light, errs @ errs.T, by_lamp, np.array(lens), 0.0, FOCAL_PX)


def evidence(lights: Lights) -> float:
    return float(np.logaddexp.reduce(lights.logarithms))


def test_images_that_show_one_unevenness_are_likelier_than_such_that_do_not() -> None:
    uneven = np.array([0.08, 0.05, 0])
    one = in_each_light([sight(turn, uneven) for turn in TURNS], LAMP_SD_DEG)
    two = in_each_light([sight(TURNS[0], uneven), sight(TURNS[1], -uneven)], LAMP_SD_DEG)
    assert evidence(one) > evidence(two) + 2


def test_what_one_image_tells_of_the_unevenness_goes_for_the_other() -> None:
    """So the centers err alike, most of all square to the turn between the cameras, where both see the same of it."""
    sights = [sight(turn, np.array([0.08, 0.05, 0])) for turn in TURNS]
    both = in_each_light(sights, LAMP_SD_DEG)
    _, together = weighed(both.logarithms, both.places, both.covariances)
    for axis, most in ((0, 1.0), (1, 0.5)):
        apart = 0.0
        for one in (in_each_light([each], LAMP_SD_DEG) for each in sights):
            apart += weighed(one.logarithms, one.places, one.covariances)[1][axis, axis]
        difference = np.zeros(6)
        difference[[axis, 3 + axis]] = 1, -1
        assert difference @ together @ difference < most * apart


def test_one_image_has_one_family_of_lights_and_two_have_two() -> None:
    sights = [sight(turn, np.zeros(3)) for turn in TURNS]
    one, both = in_each_light(sights[:1], LAMP_SD_DEG), in_each_light(sights, LAMP_SD_DEG)
    assert (one.places.shape, both.places.shape) == ((78, 3), (156, 6))
    assert np.all(np.linalg.eigvalsh(both.covariances) > 0)


def test_where_the_lens_may_make_one_side_darker_the_center_is_known_less_there() -> None:
    """By so much as it may, when the ball is even and the lamp at the lens."""
    plain, beside = (
        in_each_light([sight(np.eye(3), np.zeros(3), lens)], LAMP_SD_DEG) for lens in ((0.0, 0.0), (0.004, 0.0))
    )
    more = beside.covariances[0] - plain.covariances[0]
    assert 0.7 < np.sqrt(more[0, 0]) / (0.004 * GAIN) < 1
    assert abs(more[1, 1]) < 1e-3 * more[0, 0]


@pytest.mark.parametrize(("known_to", "least_px", "most_px"), [(0.1, 0.0, 0.08), (0.005, 0.19, 0.21)])
def test_a_balls_own_shadow_is_of_the_lamp_that_is_seen_and_not_of_noise(
    known_to: float, least_px: float, most_px: float
) -> None:
    """Light from aside of 0.2 +- 0.1 is hardly any sign of a lamp beside the lens, and of 0.2 +- 0.005 is one."""
    errs = np.diag([1e-8] * 3 + [0.01] * 2 + [known_to] * 4)
    light, by_lamp = np.array([0.0, 0, 0.2, 0, 0, 0]), np.diag([1.0, 0.0])
    plain = Sight(
        TURNS[0][:, 2], TURNS[0][:, :2], np.zeros(3), light, errs**2, by_lamp, np.zeros(2), 0.0, FOCAL_PX
    )
    sds_px = []
    for one in (plain, replace(plain, shadow_px=1.0)):
        lights = in_each_light([one], LAMP_SD_DEG)
        covariance = weighed(lights.logarithms, lights.places, lights.covariances)[1]
        sds_px.append(FOCAL_PX * np.sqrt(covariance[0, 0]))
    assert least_px < np.sqrt(sds_px[1] ** 2 - sds_px[0] ** 2) < most_px


def test_a_lamp_beside_makes_as_much_light_from_aside_as_lambert_says() -> None:
    """Whatever the law: with all light from the lamp, and the limb as dark as the ground, there is one only."""
    told, covariance = by_turning(np.array([0.0, 1, 0, 0]))
    np.testing.assert_allclose(told, (1, 0))
    np.testing.assert_allclose(covariance, 0)


@pytest.mark.parametrize("falls", [1.0, 2.0])
def test_a_limb_that_darkens_as_the_cosine_squared_is_lit_from_aside_as_the_cosine(falls: float) -> None:
    """By the angle to the lamp alone (2), by that to lamp and lens alike (1.5), or by that to the lens (1)."""
    told, covariance = by_turning(np.array([0.0, 0, 1, 0]))
    np.testing.assert_allclose(told, (0, 1.5))
    assert abs(told[1] - falls) < 2 * np.sqrt(covariance[1, 1]) < 1


def test_light_at_the_limb_may_be_the_lamps_or_the_rooms() -> None:
    of_room, of_lamp = by_turning(np.array([0.0, 0.7, 0, 0]))[0], by_turning(np.array([0.3, 0.7, 0, 0]))[0]
    doubt = np.sqrt(np.diag(by_turning(np.array([0.3, 0.7, 0, 0]))[1]))
    assert np.all(np.abs(of_lamp - of_room) < 2 * doubt)
    assert np.all(doubt > 0.3)


def test_the_powers_are_fitted_best_where_a_sphere_shows_light_from_aside() -> None:
    """By the area that shows them, times the distance from the center, squared."""
    cosine = (np.arange(100000) + 0.5) / 100000
    weight = np.sqrt(cosine * (1 - cosine**2))
    design = np.column_stack([np.ones_like(cosine), cosine]) * weight[:, None]
    for power, told in zip((-1, 0, 1, 2), LOWERED.T, strict=True):
        best = np.linalg.lstsq(design, cosine**power * weight)[0]
        np.testing.assert_allclose(told, best, atol=0.05)
