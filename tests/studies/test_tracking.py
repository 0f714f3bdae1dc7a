from typing import Any

import numpy as np
import pytest

from ronnaplan.studies.heads import X_FRAME_MM
from ronnaplan.studies.tracking import READINGS, TOLERANCES_MM, run_scan, simulate_scan, tracking_table


def test_scans_have_the_published_distance_errors_and_share_their_readings() -> None:
    def distances(points: Any) -> Any:
        return np.linalg.norm(points[..., :, None, :] - points[..., None, :, :], axis=-1)[
            ..., *np.triu_indices(4, 1)
        ]

    errors = np.array([distances(simulate_scan(scan, seed)[0]) for scan in range(5, 17) for seed in range(50)])
    errors -= distances(X_FRAME_MM)
    assert np.abs(errors).mean() == pytest.approx(0.44, abs=0.03)
    assert errors.std() == pytest.approx(0.56, abs=0.03)
    readings = [simulate_scan(scan, 1)[1] for scan in (0, 16)]
    assert readings[0].shape == (READINGS, 4, 3)
    np.testing.assert_array_equal(readings[0], readings[1])


def test_a_phantom_scan_pairs_with_every_reading_over_the_published_range_of_e() -> None:
    record = run_scan(0, 2018)
    right = np.array(record["published"])[:, 0]
    inside = (TOLERANCES_MM >= 1.8) & (TOLERANCES_MM <= 4.2)
    assert (right[inside] == READINGS).all()
    assert right[-1] < READINGS
    assert record["exact"] == [READINGS, 0, 0]
    table = tracking_table([{"scan": 0, "kind": "phantom", **record}, {"scan": 5, "kind": "patient", **record}])
    assert "| phantom | 1415 |" in table
