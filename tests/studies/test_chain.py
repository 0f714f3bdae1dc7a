"""The chain study: predicted and observed error at the target in the robot's frame, source by source."""

from pathlib import Path

import numpy as np
import pytest

from ronnaplan.geometry import Frame, Points
from ronnaplan.registration import register_points
from ronnaplan.studies import chain

MARKERS = np.array([[56.0, -61, 58], [-42, -81, 51], [-80, -13, 47], [83, 18, 36], [30, -21, 98], [-51, 52, 71]])
CT_SD_MM = 0.05


def localized(seed: int) -> chain.LocalizedPhantom:
    """A localized scan without the scan: markers off by their stated error."""
    noise = np.random.default_rng(seed).normal(size=MARKERS.shape) * CT_SD_MM
    covariances = np.tile(CT_SD_MM**2 * np.eye(3), (len(MARKERS), 1, 1))
    found = Points(MARKERS + noise, covariances, ("F1", "F2", "F3", "F4", "F5", "F6"), Frame("CT", "1.2"))
    return chain.LocalizedPhantom(found, MARKERS)


def test_predicted_and_observed_error_agree_for_all_sources_together_and_for_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chain, "scan_phantom", localized)
    rows = chain.run_chain(tmp_path, 12, seed=1, workers=1)
    assert [row["source"] for row in rows] == [*chain.SOURCES, "all"]
    ratios = {row["source"]: row["observed_rms_mm"] / row["predicted_rms_mm"] for row in rows}
    assert ratios.pop("all") == pytest.approx(1.0, abs=0.05)
    assert ratios.pop("CT localization") == pytest.approx(1.0, abs=0.4)  # six scans only
    for source, ratio in ratios.items():
        assert ratio == pytest.approx(1.0, abs=0.15), source  # 72 sessions each
    assert sum(row["share"] for row in rows[:-1]) == pytest.approx(1.0)
    assert (tmp_path / "table.md").read_text() == chain.chain_table(rows)


def test_a_stopped_study_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chain, "scan_phantom", localized)
    first = chain.run_chain(tmp_path, 1, seed=1, workers=1)
    monkeypatch.setattr(chain, "scan_phantom", None)
    assert chain.run_chain(tmp_path, 1, seed=1, workers=1) == first


def test_the_shares_of_both_sides_make_the_whole_covariance() -> None:
    rng = np.random.default_rng(2)
    both = [np.array([np.diag(rng.uniform(0.01, 0.2, 3)) for _ in MARKERS]) for _ in range(2)]
    registration = register_points(MARKERS, MARKERS + rng.normal(size=MARKERS.shape) * 0.1, (both[0], both[1]))
    moving, fixed = chain._shares(registration)
    np.testing.assert_allclose(moving + fixed, registration.pose.covariance, rtol=1e-6, atol=1e-9)
