"""The contact sheet shows accepted and rejected candidates, and an empty scan too."""

from __future__ import annotations

import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import ellipsoid
from ronnaplan.localization import localize
from ronnaplan.report.contact import contact_sheet
from tests.scans import balls, scan, small_stack


@pytest.mark.parametrize(
    "scene",
    [
        balls([(-14.3, -12.2, -3.1)]) + Scene((Part(ellipsoid((13, 11, 2), (5.75, 5.75, 7.5)), "acrylic"),)),
        balls([(300.0, 0.0, 0.0)]),
    ],
    ids=["a ball and an egg", "nothing"],
)
def test_a_sheet_is_a_picture(scene: Scene) -> None:
    volume = scan(scene, small_stack())
    assert contact_sheet(volume, localize(volume, diameter_mm=11.5)).startswith(b"\x89PNG")
