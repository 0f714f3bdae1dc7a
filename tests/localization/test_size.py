"""The sizes of a scan's balls are found without being told, or proposed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import sphere
from ronnaplan.ct.volume import CTVolume
from ronnaplan.errors import RefusedError
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import Build, Size, common_diameter, size, sizes_seen
from ronnaplan.localization.examine import Examined
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.size import commonest, proposal
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

PLACES = [(-14.3, -12.2, -3.1), (13.6, 11.7, 2.4), (15.1, -13.8, 5.3), (-13.0, 12.5, -6.0), (0.3, 0.8, 15.2)]


def test_the_commonest_size_is_found_and_the_others_are_told() -> None:
    volume = scan(balls(PLACES[:3], 9.0) + balls(PLACES[3:4], 13.0) + balls(PLACES[4:], 4.0), small_stack())
    assert common_diameter(volume) == pytest.approx(9.0, abs=0.03)
    seen = {round(size.diameter_mm): size.count for size in sizes_seen(volume)}
    assert seen == {9: 3, 13: 1, 4: 1}


def test_too_few_balls_of_one_size_are_refused_with_what_there_is() -> None:
    scene = balls(PLACES[:2], 9.0) + balls(PLACES[2:4], 13.0)
    with pytest.raises(
        RefusedError, match=r"2 spheres of 13.0\d mm, 2 spheres of (9.0|8.9)\d mm: try --diameter 13.0"
    ):
        common_diameter(scan(scene, small_stack()))


def test_of_equally_common_sizes_the_expected_number_decides_or_both_are_proposed() -> None:
    seen = (Size(11.5, 4), Size(9.0, 4), Size(5.0, 3))
    assert commonest(seen, expected=3).diameter_mm == 5.0
    with pytest.raises(
        RefusedError, match=r"try --diameter 11.5 or --diameter 9.0 or --diameter 11.5,9.0 for all"
    ):
        commonest(seen, expected=None)


CROWD = [(x, y, z) for x in (-16.0, 0.0, 16.0) for y in (-16.0, 0.0, 16.0) for z in (-7.0, 7.0)]


def fitted_for(
    monkeypatch: pytest.MonkeyPatch, volume: CTVolume, expected: int | None
) -> tuple[float, list[float]]:
    """Return the commonest diameter, and those that were fitted to know it."""
    sizes_mm: list[float] = []

    def counted(scan: Scan, center_mm: FloatArray, diameter_mm: float, marker: Build) -> Examined:
        sizes_mm.append(round(diameter_mm))
        return fit(scan, center_mm, diameter_mm, marker)

    fit = size._fitted
    with monkeypatch.context() as patched:
        patched.setattr(size, "_fitted", counted)
        return common_diameter(volume, expected), sizes_mm


def test_what_cannot_change_the_commonest_size_is_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    volume = scan(balls(CROWD[:6], 9.0) + balls(CROWD[6:10], 5.0) + balls(CROWD[10:11], 13.0), small_stack())
    common_mm, fitted_mm = fitted_for(monkeypatch, volume, None)
    assert common_mm == pytest.approx(9.0, abs=0.03)
    assert fitted_mm.count(9.0) == 6
    assert fitted_mm.count(13.0) == 0
    expected_mm, fitted_mm = fitted_for(monkeypatch, volume, 4)
    assert expected_mm == pytest.approx(5.0, abs=0.03)
    assert fitted_mm.count(5.0) == 4


def test_of_what_may_be_no_balls_the_least_round_are_fitted_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """They come to nothing soonest; once fewer than the commonest are left, nobody needs to ask of the others."""
    places = [(np.array(place), 9.0) for place in CROWD[:4]] + [(np.array(place), 5.0) for place in CROWD[4:16]]
    tried: list[int] = []

    def noted(scan: Scan, center_mm: FloatArray, diameter_mm: float, marker: Build) -> Examined:
        tried.append(next(n for n, (place, _) in enumerate(places) if place is center_mm))
        return fit(scan, center_mm, diameter_mm, marker)

    fit = size._fitted
    monkeypatch.setattr(size, "_fitted", noted)
    monkeypatch.setattr(size, "round_places", lambda *_: places)
    assert common_diameter(scan(balls(CROWD[:4], 9.0), small_stack())) == pytest.approx(9.0, abs=0.03)
    assert sorted(tried) == [*range(size.FIRST_FITTED), *range(len(places) - 5, len(places))]


@pytest.mark.parametrize("more", [3, 4])
def test_a_size_that_is_as_common_but_less_round_is_fitted_to_the_end(more: int) -> None:
    scene = balls(CROWD[:3], 9.0) + balls(CROWD[4 : 4 + more], 5.0)
    volume = scan(scene, small_stack())
    if more > 3:
        assert common_diameter(volume) == pytest.approx(5.0, abs=0.03)
    else:
        with pytest.raises(RefusedError, match="2 sizes of balls are equally common"):
            common_diameter(volume)


@few_and_others("stated_mm", [4.0], [11.5])
def test_metal_that_the_scale_does_not_hold_has_no_size(stated_mm: float) -> None:
    volume = scan(balls(PLACES[:4], stated_mm, "titanium"), small_stack(thickness_mm=0.6, spacing_mm=0.6))
    with pytest.raises(
        RefusedError, match=r"4 spheres of about (4|5|12) mm, .* hides their size; state --diameter"
    ):
        common_diameter(volume)
    ceramic = scan(balls(PLACES[:4], stated_mm, "ceramic"), small_stack(thickness_mm=0.6, spacing_mm=0.6))
    assert common_diameter(ceramic) == pytest.approx(stated_mm, abs=0.05)


def test_of_metal_and_plastic_of_one_size_the_plastic_shows_it() -> None:
    """Three balls that the scale holds were not asked where as many or more were brighter than its end."""
    stack = small_stack(thickness_mm=0.6, spacing_mm=0.6)
    metal = balls([*PLACES[3:], (0.4, -0.6, -9.3)], 11.5, "titanium")
    assert common_diameter(scan(balls(PLACES[:3], 11.5) + metal, stack)) == pytest.approx(11.5, abs=0.01)
    with pytest.raises(RefusedError, match=r"5 spheres of about 12 mm, .* hides their size; state --diameter"):
        common_diameter(scan(balls(PLACES[:2], 11.5) + metal, stack))


def test_balls_whose_edges_a_head_bends_show_their_size_once_that_is_made_good(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of ten balls of 5 mm beside a head in a dental cone beam one was seen; stated, all were found."""
    volume, fit, test = scan(balls(PLACES[:3], 9.0), small_stack()), size._fitted, "coverage"

    def bent(scan: Scan, center_mm: FloatArray, diameter_mm: float, marker: Build) -> Examined:
        return replace(fit(scan, center_mm, diameter_mm, marker), failures=((test, "as if beside a head"),))

    monkeypatch.setattr(size, "_fitted", bent)
    assert common_diameter(volume) == pytest.approx(9.0, abs=0.03)
    test = "contrast"
    with pytest.raises(RefusedError, match="no sphere of 3 to 26 mm was seen"):
        common_diameter(volume)


def test_nothing_seen_is_said() -> None:
    none = proposal(sizes_seen(scan(balls(PLACES[:1], 1.0), small_stack(matrix=32))))
    assert none.startswith("no sphere")
    assert "where --marker says so" in none  # markers that are printed or hold an insert are often hollow


def test_hollow_balls_of_unknown_size_are_found_when_asked_for() -> None:
    cavities = Scene(tuple(Part(sphere(center, 9.5), "air") for center in PLACES[:4]))
    volume = scan(balls(PLACES[:4], 11.5) + cavities, small_stack(thickness_mm=0.6, spacing_mm=0.6))
    assert common_diameter(volume, marker=Build.parse("shell:1")) == pytest.approx(11.5, abs=0.03)
    assert not [size for size in sizes_seen(volume) if abs(size.diameter_mm - 11.5) < 1.0]
