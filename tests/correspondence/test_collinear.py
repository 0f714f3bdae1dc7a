import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.correspondence.collinear import is_collinear, largest_eigenvalue, off_one_line


def test_points_are_collinear_within_their_error_only() -> None:
    line = np.outer([0.0, 40.0, 90.0, 150.0], [0.6, 0.8, 0.0])
    bent = line + np.outer([0, 4.0, 0, 0], [0.0, 0.0, 1.0])
    assert is_collinear(line, np.full(4, 0.1**2))
    assert is_collinear(bent, np.full(4, 1.0**2))
    assert not is_collinear(bent, np.full(4, 0.1**2))
    assert is_collinear(bent, np.array([0.1, 10.0, 0.1, 0.1]) ** 2)  # what is off the line may be on it
    assert not is_collinear(
        bent, np.array([0.1, 0.1, 0.1, 100.0]) ** 2
    )  # one that is hardly known does not hide it


@pytest.mark.parametrize(
    ("values", "error"),
    [((0, 0, 0), 0.0), ((0, 0, 5), 1e-14), ((1e-6, 1e-6, 1e9), 1e-14), ((1, 2, 3), 1e-14), ((0, 5, 5), 1e-7)],
)
def test_the_largest_eigenvalue_is_that_of_lapack(values: tuple[float, ...], error: float) -> None:
    """To the last digits where points lie on a line; less exactly where two eigenvalues are as large."""
    for turn in Rotation.random(20, random_state=1).as_matrix():
        m = turn @ np.diag(values) @ turn.T
        assert largest_eigenvalue(m) == pytest.approx(np.linalg.eigvalsh(m)[2], rel=error, abs=1e-300)


@pytest.mark.parametrize("off", [0, 1, 5])
def test_a_point_off_a_line_is_named_however_far_it_lies(off: int) -> None:
    """Also where it draws the line that fits all to itself; of five, three."""
    for seed in range(20):
        rng = np.random.default_rng([off, seed])
        points = rng.uniform(-50.0, 50.0, (10, 1)) * [1.0, 2.0, 0.0] + 0.5 * rng.normal(size=(10, 3))
        points[:off] += rng.choice([-1.0, 1.0], (off, 1)) * rng.uniform(15.0, 80.0, (off, 1)) * [-2.0, 1.0, 0.0]
        points[:off, 2] += rng.uniform(-80.0, 80.0, off)
        named = np.flatnonzero(off_one_line(points, np.full(10, 0.25)))
        assert len(named) == 3 if off == 5 else named.tolist() == list(range(off))
