"""The contacts of an electrode lie where its maker has them, and are judged one by one as the path is."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, Frame
from ronnaplan.planning import Instrument, Limits, Trajectory, judge, measure
from ronnaplan.planning.contacts import contact_ends_mm, contact_paths
from ronnaplan.planning.electrodes import ELECTRODES, electrode_named
from ronnaplan.planning.obstacles import Kind, Voxels
from tests.planning.heads import BRAIN, SCALP, reach, scanned

CT = Frame("CT", "1.2.3")
NEEDLE = Instrument("needle", 2.0, 150.0)

SPANS_MM = {
    **{"DIXI D08-05AM": 16.0, "DIXI D08-08AM": 26.5, "DIXI D08-10AM": 33.5, "DIXI D08-12AM": 40.5},
    **{"DIXI D08-15AM": 51.0, "DIXI D08-18AM": 61.5, "Ad-Tech RD10R-SP05X": 47.29, "Ad-Tech SD08R-SP05X": 37.41},
    **{"PMT 2102-16-091": 54.5, "Medtronic 3387": 10.5, "Medtronic 3389": 7.5, "Boston Scientific Vercise": 15.5},
    **{"Abbott Infinity 6172": 7.5, "Abbott Infinity 6173": 10.5},
}
"""From the first edge of the first contact to the last of the last, as the makers' catalogues add them up."""


@pytest.mark.parametrize("name", SPANS_MM)
def test_all_contacts_together_are_as_long_as_the_catalogue_says(name: str) -> None:
    one = ELECTRODES[name]
    assert np.ptp(one.from_tip_mm) + one.contact_mm == pytest.approx(SPANS_MM[name])
    assert len(one.from_tip_mm) == one.count


def test_every_model_names_its_source_and_an_unknown_one_is_refused() -> None:
    assert all(one.source and one.diameter_mm > 0 and one.gap_mm > 0 for one in ELECTRODES.values())
    with pytest.raises(InputError, match="unknown electrode 'D08'; expected one of DIXI D08-05AM"):
        electrode_named("D08")


def vertical(model: str, target: FloatArray, instrument: Instrument = NEEDLE) -> Trajectory:
    up = np.array([0.0, 0.0, 1.0])
    entry = target + reach(target, up, SCALP) * up
    return Trajectory("A", entry, target, CT, instrument, electrode=ELECTRODES[model])


def test_contacts_lie_along_the_path_from_its_target() -> None:
    path = vertical("Medtronic 3389", np.array([1.0, 2.0, 3.0]))
    assert path.contacts_mm.tolist() == [pytest.approx([1.0, 2.0, 3.0 + z]) for z in (2.25, 4.25, 6.25, 8.25)]
    first = contact_paths(path)[0]
    assert first.target_mm == pytest.approx([1.0, 2.0, 4.5])
    assert first.entry_mm == pytest.approx([1.0, 2.0, 6.0])
    none = Trajectory("B", path.entry_mm, path.target_mm)
    assert (none.contacts_mm.shape, contact_ends_mm(none).shape) == ((0, 3), (0, 2, 3))


def test_the_contact_that_comes_nearest_to_a_region_is_named_with_its_own_distance() -> None:
    """A block beside the third contact: as far from it as its face, and the sleeve of the instrument does not count."""
    head = scanned("plain")
    grid = head.volume.grid
    k, j, i = (int(value) for value in np.rint(grid.indices(np.array([10.0, 0.0, 25.0]))))
    mask = np.zeros(head.volume.voxels_hu.shape, dtype=np.bool_)
    mask[k, j - 2 : j + 3, i - 2 : i + 3] = True
    vessel = Voxels.of(Kind.NO_GO, "vessel", mask, head)
    face = grid.positions_mm(np.array([k, j, i - 2.0])) - 0.5 * grid.column_step_mm
    target = np.array([face[0] - 5.0, face[1], face[2] - 8.0])  # the third of 3.5 mm each: its middle 8 mm above
    measured = measure(vertical("DIXI D08-10AM", target), head, obstacles=[vessel])
    verdict = next(one for one in judge(measured, Limits()) if one.measure == "contacts to vessel")
    assert verdict.value == pytest.approx(5.0 - 0.4, abs=1e-6)
    assert verdict.remark.startswith("contact 3")
    assert verdict.passes
    broken = next(
        one for one in judge(measured, Limits(least_no_go_distance_mm=4.7)) if one.measure == "contacts to vessel"
    )
    assert not broken.passes
    assert measured.clearances[0].clearance_mm == pytest.approx(5.0 - 1.0, abs=1e-6)  # of the path
    far = measured.contacts[8].clearances[0].clearance_mm
    apart = 6 * 3.5 - 1.0 - grid.thickness_mm / 2 if grid.thickness_mm else 0.0
    assert far == pytest.approx(np.hypot(5.0, apart) - 0.4, abs=0.01)


def test_contacts_that_are_not_within_the_skull_are_told_and_a_thick_electrode_too() -> None:
    target = np.array([0.0, 0.0, 40.0])
    to_brain = reach(target, np.array([0.0, 0.0, 1.0]), BRAIN)
    thin = Instrument("thin", 0.7, 150.0)
    measured = measure(vertical("DIXI D08-15AM", target, thin), scanned("plain"))
    edges = 2.0 + 3.5 * np.arange(15)  # upper edges from the target
    outside = [n + 1 for n in range(15) if edges[n] > to_brain]
    assert outside
    assert [one.number for one in measured.contacts if one.inside is False] == outside
    assert f"contacts that do not lie within the inner table: {', '.join(map(str, outside))}" in measured.doubts
    assert any("0.8 mm thick but the path is judged for an instrument of 0.7 mm" in one for one in measured.doubts)


def test_while_an_end_is_dragged_contacts_are_placed_and_not_judged() -> None:
    head = scanned("plain", wire=True)
    mask = np.zeros(head.volume.voxels_hu.shape, dtype=np.bool_)
    mask[10, 10, 10] = True
    vessel = Voxels.of(Kind.NO_GO, "vessel", mask, head)
    path = vertical("Medtronic 3387", np.array([0.0, 0.0, 10.0]))
    rough = measure(path, head, obstacles=[vessel], rough=True)
    assert [one.center_mm.tolist() for one in rough.contacts] == path.contacts_mm.tolist()
    assert all(one.clearances == () for one in rough.contacts)
    assert not any(one.measure.startswith("contacts") for one in judge(rough, Limits()))
