"""What a turn makes of a ball that it sees in other places from other directions is measured as far as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import cylinder
from ronnaplan.ct.volume import CTVolume
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import examine_place
from ronnaplan.localization.judge.motion import PATTERNS, Movement
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.moving import LIMIT
from tests.long import few_and_others
from tests.scans import balls, bent, scan, small_stack

PLACE = (1.3, -2.4, 0.7)
CLOSE = small_stack(spacing_mm=0.5, start_mm=-16, stop_mm=16, matrix=80, field_of_view_mm=40)
WITHIN_TURN = slice(PATTERNS.index("third cos"), None)


def on_a_thin_post(diameter_mm: float, material: str, post: str, post_mm: float = 3.0) -> Scene:
    """A ball on a peg."""
    top_mm = (PLACE[0] + diameter_mm / 2 + 9.0, *PLACE[1:])
    peg = Part(cylinder(top_mm, (-1.0, 0.0, 0.0), 9.05, post_mm), post, embedded=True)
    return Scene((*balls([PLACE], diameter_mm, material).parts, peg))


def movement(seen: CTVolume, diameter_mm: float) -> Movement:
    """What is found of how the ball at the place moved."""
    found = examine_place(Scan(seen), np.array(PLACE), diameter_mm, SOLID)
    assert found.movement is not None, found.failures
    return found.movement


@few_and_others("harmonic", ["third cos", "across sin"], ["third sin", "fifth cos"])
@few_and_others(("diameter_mm", "blur_mm"), [(5.0, 0.7)], [(11.5, 0.5)])
def test_a_bending_is_measured_as_large_as_it_is(harmonic: str, diameter_mm: float, blur_mm: float) -> None:
    """Small balls under soft kernels show it less at their edges than in the streaks beside them."""
    still = scan(balls([PLACE], diameter_mm), CLOSE, blur_mm=blur_mm, noise_hu=2.0)
    found = movement(bent(still, harmonic, 0.04), diameter_mm)
    expected_mm = np.where(np.array(PATTERNS) == harmonic, 0.04, 0.0)
    assert np.abs(found.amplitudes_mm - expected_mm)[WITHIN_TURN].max() < 0.004


@few_and_others(
    ("diameter_mm", "material", "post", "post_mm", "by_mm"),
    [
        (6.0, "aluminium", "polyethylene", 3.0, 0.0),
        (6.0, "aluminium", "polyethylene", 3.0, 0.06),
        (10.0, "PEEK", "polyethylene", 2.5, 0.0),
        (10.0, "PEEK", "polyethylene", 2.5, 0.06),
    ],
    [(6.0, "aluminium", "acrylic", 3.0, 0.0)],
)
def test_a_thin_post_beside_air_that_the_scale_does_not_show_is_no_motion(
    diameter_mm: float, material: str, post: str, post_mm: float, by_mm: float
) -> None:
    """Air lies at -1200 HU, and the scale begins at -1024; a ball whose edge is bent by 60 um is still told."""
    still = scan(on_a_thin_post(diameter_mm, material, post, post_mm), CLOSE, blur_mm=0.55, noise_hu=20.0)
    shown_hu = np.maximum(bent(still, "third cos", by_mm).voxels_hu - 200.0, -1024.0)
    cut = replace(still, voxels_hu=np.round(shown_hu).astype(np.int16))
    assert (movement(cut, diameter_mm).statistic > LIMIT) == (by_mm > 0.0)


@pytest.mark.parametrize("by_mm", [0.0, 0.06])
def test_a_thin_post_under_dense_ceramic_is_no_motion(by_mm: float) -> None:
    """The post is fainter than a tenth of the ball's contrast; a ball whose edge is bent by 60 um is still told."""
    still = scan(on_a_thin_post(8.0, "ceramic", "polyethylene"), CLOSE, blur_mm=0.55, noise_hu=10.0)
    assert (movement(bent(still, "third cos", by_mm), 8.0).statistic > LIMIT) == (by_mm > 0.0)
