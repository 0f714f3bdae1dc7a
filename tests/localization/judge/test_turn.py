"""What a turn makes of a ball that it sees in other places from other directions is measured as far as it is."""

from __future__ import annotations

import numpy as np

from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import examine_place
from ronnaplan.localization.judge.motion import PATTERNS
from ronnaplan.localization.scanner.scan import Scan
from tests.long import few_and_others
from tests.scans import balls, bent, scan, small_stack

PLACE = (1.3, -2.4, 0.7)
CLOSE = small_stack(spacing_mm=0.5, start_mm=-16, stop_mm=16, matrix=80, field_of_view_mm=40)
WITHIN_TURN = slice(PATTERNS.index("third cos"), None)


@few_and_others("harmonic", ["third cos", "across sin"], ["third sin", "fifth cos"])
@few_and_others(("diameter_mm", "blur_mm"), [(5.0, 0.7)], [(11.5, 0.5)])
def test_a_bending_is_measured_as_large_as_it_is(harmonic: str, diameter_mm: float, blur_mm: float) -> None:
    """Small balls under soft kernels show it less at their edges than in the streaks beside them."""
    still = scan(balls([PLACE], diameter_mm), CLOSE, blur_mm=blur_mm, noise_hu=2.0)
    found = examine_place(Scan(bent(still, harmonic, 0.04)), np.array(PLACE), diameter_mm, SOLID)
    assert found.movement is not None, found.failures
    expected_mm = np.where(np.array(PATTERNS) == harmonic, 0.04, 0.0)
    assert np.abs(found.movement.amplitudes_mm - expected_mm)[WITHIN_TURN].max() < 0.004
