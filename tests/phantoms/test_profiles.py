from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from phantoms.averages import average_hu
from phantoms.errors import PhantomError
from phantoms.profiles import Profile, Shape
from phantoms.scene import Part, Scene
from phantoms.solids import cylinder
from phantoms.stack import axial_stack


@pytest.mark.parametrize("shape", get_args(Shape))
def test_a_thin_disc_shows_the_profile_that_was_asked_for(shape: Shape) -> None:
    disc = Scene((Part(cylinder((0, 0, -0.01), (0, 0, 1), 0.02, 30), "water"),))
    stack = axial_stack(start_mm=-3, stop_mm=3, spacing_mm=0.02, matrix=16, field_of_view_mm=8)
    seen = average_hu(disc, stack, Profile(shape, 1.3))[:, 8, 8] + 1000
    assert np.ptp(stack.positions_mm[seen >= seen.max() / 2]) == pytest.approx(1.3, abs=0.03)
    assert seen.sum() * 0.02 == pytest.approx(1000 * 0.02, rel=1e-3)
    variance = np.average(stack.positions_mm**2, weights=seen)
    # A box has w^2 / 12, a triangle w^2 / 6, a Gaussian w^2 / (8 ln 2); the trapezoid is box * box of 1 and 0.6.
    expected = {"box": 1 / 12, "triangle": 1 / 6, "gaussian": 1 / (8 * np.log(2)), "trapezoid": 1.36 / 12}
    assert variance == pytest.approx(expected[shape] * 1.3**2, rel=0.01)


def test_a_profile_without_width_is_refused() -> None:
    with pytest.raises(PhantomError, match="expected a positive width"):
        Profile("gaussian", 0.0)
