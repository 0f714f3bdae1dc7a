"""What lies between voxels is what their neighbours say."""

from __future__ import annotations

import numpy as np

from ronnaplan.ct.sampling import sampled


def test_between_voxels_lies_what_lies_between_their_values_and_beyond_them_what_was_asked_for() -> None:
    k, j, i = np.indices((3, 4, 5))
    voxels = (100 * k * j + 10 * i).astype(np.int16)  # linear along each axis
    indices = np.array([[0.0, 0.0, 0.0], [1.25, 2.5, 3.75], [2.0, 3.0, 4.0], [2.01, 3.0, 4.0], [1.0, -0.01, 1.0]])
    expected = [0.0, 100 * 1.25 * 2.5 + 37.5, 640.0, -7.0, -7.0]
    np.testing.assert_allclose(sampled(voxels, indices, -7.0), expected, rtol=1e-6)
