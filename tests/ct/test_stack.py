from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydicom.dataset import Dataset
from pydicom.uid import ExplicitVRBigEndian, ExplicitVRLittleEndian
from scipy.spatial.transform import Rotation

from ronnaplan.ct import VolumeFlag, find_series, read_ct
from ronnaplan.ct.stack import stacks_of
from ronnaplan.errors import InputError
from tests.ct.makers import Change, compress, dataset, enhanced, pattern, save, slice_image, write_series

POSITIONS = {
    "head first prone": [-1, 0, 0, 0, -1, 0],
    "head first decubitus left": [0, 1, 0, -1, 0, 0],
    "head first decubitus right": [0, -1, 0, 1, 0, 0],
    "feet first supine": [-1, 0, 0, 0, 1, 0],
    "feet first prone": [1, 0, 0, 0, -1, 0],
    "sagittal": [0, 1, 0, 0, 0, -1],
    "coronal": [1, 0, 0, 0, 0, -1],
}


def placed(origins: list[list[float]], **also: object) -> Change:
    def change(made: Dataset, k: int) -> None:
        made.ImagePositionPatient = origins[k]
        for keyword, value in also.items():
            setattr(made, keyword, value)

    return change


def tilted(tilt_deg: float, tag: float | None) -> Change:
    """Slices every 2 mm along the table, in planes tilted about x: origins drift within the slice plane."""
    angle = np.radians(tilt_deg)

    def change(made: Dataset, k: int) -> None:
        made.ImageOrientationPatient = [1, 0, 0, 0, round(np.cos(angle), 9), round(-np.sin(angle), 9)]
        made.ImagePositionPatient, made.SliceThickness = [0, 0, 2 * k], 1
        if tag is not None:
            made.GantryDetectorTilt = tag

    return change


@pytest.mark.parametrize("tag", [18.5, -18.5, None])
def test_gantry_tilt_comes_from_the_positions_with_or_without_its_tag(tmp_path: Path, tag: float | None) -> None:
    volume = read_ct(write_series(tmp_path, change=tilted(18.5, tag)))
    assert volume.grid.tilt_deg == pytest.approx(18.5, abs=1e-4)
    assert volume.grid.positions_mm(np.array([3.0, 0, 0])) == pytest.approx([0, 0, 6])
    assert np.allclose(volume.grid.spacings_mm, 2 * np.cos(np.radians(18.5)))
    assert volume.flags == ()


@pytest.mark.parametrize(("actual", "tag"), [(18.5, 0.0), (0.0, 20.0), (18.5, 12.0)])
def test_a_contradicting_tilt_tag_is_flagged_and_the_positions_win(
    tmp_path: Path, actual: float, tag: float
) -> None:
    volume = read_ct(write_series(tmp_path, change=tilted(actual, tag)))
    assert volume.grid.tilt_deg == pytest.approx(actual, abs=1e-4)
    assert VolumeFlag.TILT_CONTRADICTS in volume.flags


@pytest.mark.parametrize(("along_row", "along_column"), [(0.3, 0.0), (0.0, 0.3)])
def test_slices_that_shift_sideways_as_by_no_gantry_are_flagged(
    tmp_path: Path, along_row: float, along_column: float
) -> None:
    """Axial slices, each displaced against the one before, and no tilt is told: markers in it are no balls."""
    sheared = placed([[along_row * k, along_column * k, 2 * k] for k in range(4)])
    assert read_ct(write_series(tmp_path, change=sheared)).flags == (VolumeFlag.SHEARED,)


def test_a_head_that_was_turned_with_its_tilted_slices_is_not_called_sheared(tmp_path: Path) -> None:
    """Its tag tells of the tilt, though the slices are axial now, and their line is not the table's."""
    origins = [[0, 2 * k * np.sin(np.radians(12)), 2 * k * np.cos(np.radians(12))] for k in range(4)]
    tilted_tag = placed([[float(x) for x in origin] for origin in origins], GantryDetectorTilt=12)
    assert read_ct(write_series(tmp_path, change=tilted_tag)).flags == (VolumeFlag.OVERLAPPING,)


@pytest.mark.parametrize("name", list(POSITIONS))
def test_every_patient_position_keeps_each_voxel_where_its_slice_says(tmp_path: Path, name: str) -> None:
    directions = np.array(POSITIONS[name], dtype=float)
    normal = np.cross(directions[:3], directions[3:])
    for sign in (1, -1):
        folder = tmp_path / str(sign)
        origins = [(sign * 3.0 * k * normal + [5, 6, 7]).tolist() for k in range(4)]
        write_series(folder, change=placed(origins, ImageOrientationPatient=POSITIONS[name]))
        volume = read_ct(folder)
        for k in range(4):
            at = np.flatnonzero(volume.voxels_hu[:, 0, 0] == pattern(k)[0, 0] - 1024)[0]
            expected = np.array(origins[k]) + 2 * 0.5 * directions[3:] + 3 * 0.75 * directions[:3]
            assert np.allclose(volume.grid.positions_mm(np.array([at, 2.0, 3.0])), expected)


@settings(max_examples=25)
@given(
    angles=st.tuples(*[st.floats(-180, 180)] * 3),
    gaps=st.lists(st.floats(0.1, 9.0), min_size=2, max_size=6),
    drift=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    order=st.randoms(use_true_random=False),
)
def test_turning_the_patient_turns_every_voxel_with_him(
    tmp_path_factory: pytest.TempPathFactory,
    angles: tuple[float, float, float],
    gaps: list[float],
    drift: tuple[float, float],
    order: Random,
) -> None:
    turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    heights = np.concatenate([[0.0], np.cumsum(gaps)])
    origins = np.outer(heights, [*drift, 1.0]) + np.array([10.0, -20.0, 30.0])
    numbers = list(range(len(heights)))
    order.shuffle(numbers)

    def change(made: Dataset, k: int) -> None:
        made.ImagePositionPatient = [f"{value:.9f}"[:16] for value in turn @ origins[numbers[k]]]
        made.ImageOrientationPatient = [f"{value:.12f}"[:16] for value in (*turn[:, 0], *turn[:, 1])]

    folder = tmp_path_factory.mktemp("turned")
    volume = read_ct(write_series(folder, len(heights), change))
    kji = np.array([[k, j, i] for k in range(len(heights)) for j in (0.0, 7.0) for i in (0.0, 9.0)])
    still = origins[kji[:, 0].astype(int)] + kji[:, 1:2] * [0, 0.5, 0] + kji[:, 2:3] * [0.75, 0, 0]
    assert np.allclose(volume.grid.positions_mm(kji), still @ turn.T, atol=1e-5)
    expected = [pattern(numbers.index(k))[0, 0] - 1024 for k in range(len(heights))]
    assert volume.voxels_hu[:, 0, 0].tolist() == expected


def test_thickness_and_spacing_tags_never_place_a_slice(tmp_path: Path) -> None:
    change = placed(
        [[0, 0, 2 * k] for k in range(4)], SliceThickness=1.5, SpacingBetweenSlices=7, SliceLocation=99
    )
    volume = read_ct(write_series(tmp_path, change=change))
    assert volume.grid.spacings_mm.tolist() == [2, 2, 2]
    assert volume.grid.thickness_mm == 1.5


def test_uneven_spacing_is_kept_exactly_and_flagged(tmp_path: Path) -> None:
    heights = [0, 4.002, 5.083, 12.082]
    volume = read_ct(write_series(tmp_path, change=placed([[0, 0, z] for z in heights], SliceThickness=1)))
    assert volume.grid.slice_positions_mm.tolist() == heights
    assert volume.flags == (VolumeFlag.UNEVEN_SPACING,)


def test_one_gap_a_multiple_of_the_rest_is_a_missing_slice(tmp_path: Path) -> None:
    volume = read_ct(write_series(tmp_path, 5, placed([[0, 0, z] for z in (0, 5, 10, 20, 25)])))
    assert volume.grid.slice_positions_mm.tolist() == [0, 5, 10, 20, 25]
    assert volume.flags == (VolumeFlag.UNEVEN_SPACING, VolumeFlag.MISSING_SLICE)


@pytest.mark.parametrize(("lost", "flags"), [(None, ()), (6, (VolumeFlag.MISSING_SLICE,))])
def test_slices_that_become_thicker_neither_overlap_nor_miss_one(
    tmp_path: Path, lost: int | None, flags: tuple[VolumeFlag, ...]
) -> None:
    slices = [(2.0 * k, 2) for k in range(5)] + [(11.0 + 4.0 * k, 4) for k in range(4)]
    kept = [one for k, one in enumerate(slices) if k != lost]

    def change(made: Dataset, k: int) -> None:
        made.ImagePositionPatient, made.SliceThickness = [0, 0, kept[k][0]], kept[k][1]

    volume = read_ct(write_series(tmp_path, len(kept), change))
    assert volume.flags == (VolumeFlag.UNEVEN_SPACING, *flags)


def test_overlapping_reconstructions_are_read_and_flagged(tmp_path: Path) -> None:
    volume = read_ct(write_series(tmp_path, change=placed([[0, 0, 0.5 * k] for k in range(4)], SliceThickness=1)))
    assert volume.grid.spacings_mm.tolist() == [0.5, 0.5, 0.5]
    assert volume.flags == (VolumeFlag.OVERLAPPING,)


def test_a_slice_shifted_sideways_is_read_where_it_is_and_flagged(tmp_path: Path) -> None:
    volume = read_ct(write_series(tmp_path, change=placed([[0, 0, 0], [0, 0, 2], [1, 0, 4], [0, 0, 6]])))
    assert volume.grid.origins_mm[2].tolist() == [1, 0, 4]
    assert VolumeFlag.SHIFTED_SIDEWAYS in volume.flags


def test_identical_copies_are_dropped_with_a_flag(tmp_path: Path) -> None:
    write_series(tmp_path)
    write_series(tmp_path, prefix="copy")
    volume = read_ct(tmp_path)
    assert volume.voxels_hu.shape[0] == 4
    assert volume.flags == (VolumeFlag.DUPLICATES_DROPPED,)


@pytest.mark.parametrize("syntax", ["1.2.840.10008.1.2", "1.2.840.10008.1.2.2", "1.2.840.10008.1.2.4.80"])
def test_copies_in_another_transfer_syntax_are_dropped_only_where_their_values_are_the_same(
    syntax: str, tmp_path: Path
) -> None:
    """As of an archive that exported a series twice, once compressed or big endian."""
    write_series(tmp_path)
    for k in range(4):
        made = dataset(k)
        if syntax.endswith(".80"):
            compress(made, syntax, tmp_path)
        save(made, tmp_path / f"copy{k}", syntax)
    volume = read_ct(tmp_path)
    assert np.array_equal(volume.voxels_hu, [pattern(k) - 1024 for k in range(4)])
    assert volume.flags == (VolumeFlag.DUPLICATES_DROPPED,)
    other = pattern(1)
    other[3, 3] += 1
    save(dataset(1, stored=other), tmp_path / "copy1")
    save(dataset(1), tmp_path / "001", "1.2.840.10008.1.2")
    with pytest.raises(InputError, match=r"different images lie at the same place \(.*001 and .*copy1\)"):
        read_ct(tmp_path)


def test_different_images_of_one_instance_uid_are_flagged(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        if k > 1:
            made.SOPInstanceUID = "1.2.3.4"

    assert read_ct(write_series(tmp_path, change=change)).flags == (VolumeFlag.SAME_INSTANCE,)


def test_different_images_at_one_place_are_refused(tmp_path: Path) -> None:
    write_series(tmp_path, change=placed([[0, 0, 0], [0, 0, 2], [0, 0, 2], [0, 0, 4]]))
    with pytest.raises(InputError, match=r"images lie at the same place \(.*001 and .*002\), .*; put the files"):
        read_ct(tmp_path)


@pytest.mark.parametrize(
    ("told_by", "told"),
    [("AcquisitionNumber", "acquisition"), ("TemporalPositionIdentifier", "acquisition 1 time")],
)
def test_two_acquisitions_of_one_place_are_offered_apart(told_by: str, told: str, tmp_path: Path) -> None:
    """The second as of a heart or a bolus, which is scanned again and again."""
    write_series(tmp_path, change=lambda made, k: setattr(made, told_by, 1))

    def second(made: Dataset, k: int) -> None:
        made.RescaleIntercept = -1000
        setattr(made, told_by, 2)

    write_series(tmp_path, 4, second, prefix="second")
    with pytest.raises(InputError, match=rf"#1 .*, {told} 1\).*1\.2\.3\.2#2 .*, {told} 2\)"):
        read_ct(tmp_path)
    volumes = [read_ct(tmp_path, f"1.2.3.2#{number}") for number in (1, 2)]
    assert {int(volume.voxels_hu[0, 0, 0]) for volume in volumes} == {-1024, -1000}
    assert {volume.source.series_instance_uid for volume in volumes} == {"1.2.3.2"}


@pytest.mark.parametrize(
    ("told_by", "values", "told"),
    [
        ("NominalPercentageOfCardiacPhase", (40.0, 75.0), ("cardiac phase 40 %", "cardiac phase 75 %")),
        ("SeriesNumber", (4, 5), ("series number 4", "series number 5")),
        ("SeriesDescription", ("bone", "soft"), ("description bone", "description soft")),
    ],
)
def test_two_scans_between_each_others_slices_are_offered_apart(
    told_by: str, values: tuple[object, object], told: tuple[str, str], tmp_path: Path
) -> None:
    """As of a heart at two times, or where taking names away gave two series one UID: they were read as one volume."""
    for name, value, start_mm in zip("ab", values, (0.0, 0.7), strict=True):

        def change(made: Dataset, k: int, value: object = value, start_mm: float = start_mm) -> None:
            made.ImagePositionPatient = [0, 0, start_mm + 2 * k]
            setattr(made, told_by, value)

        write_series(tmp_path, change=change, prefix=name)
    found = find_series(tmp_path).usable
    assert [series.part for series in found] == [(told[0],), (told[1],)]
    places = [read_ct(tmp_path, series.key).grid.slice_positions_mm for series in found]
    np.testing.assert_allclose(np.stack(places), np.array([[0.0, 2.0, 4.0, 6.0], [0.7, 2.7, 4.7, 6.7]]))


@pytest.mark.parametrize(
    ("told_by", "usual", "other", "others"),
    [
        ("SeriesDescription", "head", "head, the aneurysm", {5}),
        ("SeriesDescription", "head", "", {0, 11}),
        ("SeriesNumber", 4, None, {5}),
        ("NominalPercentageOfCardiacPhase", 75.0, 74.0, {4, 5, 6, 7}),
    ],
)
def test_a_scan_of_which_some_slices_are_told_otherwise_is_one(
    told_by: str, usual: object, other: object, others: set[int], tmp_path: Path
) -> None:
    """Step by step at each beat, or described by hand: it was torn apart, and slices were left out of it."""

    def change(made: Dataset, k: int) -> None:
        made.ImagePositionPatient = [0, 0, round(0.625 * k, 2)]
        setattr(made, told_by, other if k in others else usual)

    volume = read_ct(write_series(tmp_path, 12, change))
    assert len(volume.grid.slice_positions_mm) == 12
    assert not {VolumeFlag.IMAGES_LEFT_OUT, VolumeFlag.MISSING_SLICE} & set(volume.flags)


@pytest.mark.parametrize("syntax", [ExplicitVRLittleEndian, ExplicitVRBigEndian])
def test_frames_of_two_cardiac_phases_are_offered_apart(syntax: str, tmp_path: Path) -> None:
    def change(groups: Dataset, k: int) -> None:
        groups.PlanePositionSequence[0].ImagePositionPatient = [0, 0, k % 4 + 0.3 * (k // 4)]
        groups.CardiacSynchronizationSequence = [Dataset()]
        groups.CardiacSynchronizationSequence[0].NominalPercentageOfCardiacPhase = (40.0, 75.0)[k // 4]

    save(enhanced(8, change), tmp_path / "twice", syntax)
    with pytest.raises(InputError, match=r"#1 .*, cardiac phase 40 %\).*#2 .*, cardiac phase 75 %\)"):
        read_ct(tmp_path)


@pytest.mark.parametrize("syntax", [ExplicitVRLittleEndian, ExplicitVRBigEndian])
@pytest.mark.parametrize(("told_by", "told"), [("FrameAcquisitionNumber", ""), ("TemporalPositionIndex", "time ")])
def test_frames_of_one_place_are_offered_by_numbers_that_can_be_read(
    told_by: str, told: str, syntax: str, tmp_path: Path
) -> None:
    """They were told by the bytes of these numbers: acquisition 01000000."""

    def change(groups: Dataset, k: int) -> None:
        groups.PlanePositionSequence[0].ImagePositionPatient = [0, 0, k % 4]
        setattr(groups.FrameContentSequence[0], told_by, 1 + k // 4)

    save(enhanced(8, change), tmp_path / "twice", syntax)
    with pytest.raises(InputError, match=rf"#1 .*, acquisition {told}1\).*#2 .*, acquisition {told}2\)"):
        read_ct(tmp_path)


def test_two_kernels_of_one_place_are_offered_apart(tmp_path: Path) -> None:
    write_series(tmp_path)

    def sharp(made: Dataset, k: int) -> None:
        made.ConvolutionKernel, made.RescaleIntercept = "H60", -1023

    write_series(tmp_path, 4, sharp, prefix="sharp")
    assert [(series.kernel, series.apart, series.part) for series in find_series(tmp_path).usable] == [
        ("H30", ("kernels",), ("kernel H30",)),
        ("H60", ("kernels",), ("kernel H60",)),
    ]
    assert read_ct(tmp_path, "1.2.3.2#2").source.kernel == "H60"


def test_acquisitions_that_follow_each_other_are_one_volume(tmp_path: Path) -> None:
    volume = read_ct(write_series(tmp_path, change=lambda made, k: setattr(made, "AcquisitionNumber", k // 2)))
    assert volume.voxels_hu.shape[0] == 4


@pytest.mark.parametrize(
    ("keyword", "value", "apart"),
    [
        ("ImageOrientationPatient", [0, 1, 0, 0, 0, -1], "orientations"),
        ("FrameOfReferenceUID", "1.2.3.99", "frames of reference"),
        ("StudyInstanceUID", "1.2.3.98", "studies"),
        ("PatientID", "another patient's", "patients"),
        ("PatientName", "Roe^Richard", "patients"),
        ("PatientBirthDate", "19600101", "patients"),
        ("PatientPosition", "FFS", "patient positions"),
        ("PixelSpacing", [0.5, 0.5], "pixel spacings"),
    ],
)
def test_orientations_frames_and_pixel_sizes_are_never_mixed(
    tmp_path: Path, keyword: str, value: object, apart: str
) -> None:
    write_series(tmp_path)

    def other(made: Dataset, k: int) -> None:
        made.ImagePositionPatient = [3 * k, 0, 2 * k]
        setattr(made, keyword, value)

    write_series(tmp_path, 3, other, prefix="other")
    found = find_series(tmp_path)
    assert [series.key for series in found.series] == ["1.2.3.2#1", "1.2.3.2#2"]
    assert sorted(series.image_count for series in found.series) == [3, 4]
    assert [series.apart for series in found.series] == [(apart,), (apart,)]
    with pytest.raises(InputError, match=r"choose one"):
        read_ct(tmp_path, "1.2.3.2")


@pytest.mark.parametrize(
    ("keyword", "value"),
    [
        ("Rows", 4),
        ("ImageOrientationPatient", [0, 1, 0, 0, 0, -1]),
        ("PatientID", "another patient's"),
        ("FrameOfReferenceUID", "1.2.3.99"),
    ],
)
def test_an_end_slice_that_does_not_fit_is_left_out_with_a_flag(
    tmp_path: Path, keyword: str, value: object
) -> None:
    def change(made: Dataset, k: int) -> None:
        if k == 3:
            setattr(made, keyword, value)
            if keyword == "Rows":
                made.PixelData = made.PixelData[: 2 * made.Rows * made.Columns]

    found = find_series(write_series(tmp_path, change=change))
    assert [(series.image_count, series.is_usable) for series in found.series] == [(3, True), (1, False)]
    assert read_ct(tmp_path).flags == (VolumeFlag.IMAGES_LEFT_OUT,)


def test_two_tube_voltages_among_each_other_are_offered_apart(tmp_path: Path) -> None:
    write_series(tmp_path, 8, lambda made, k: setattr(made, "KVP", (80, 140)[k % 2]))
    with pytest.raises(InputError, match=r"2 usable series.*1\.2\.3\.2#1.*1\.2\.3\.2#2"):
        read_ct(tmp_path)
    assert read_ct(tmp_path, "1.2.3.2#2").grid.slice_positions_mm.tolist() == [32, 36, 40, 44]


def test_a_tube_voltage_that_changes_along_the_volume_is_flagged(tmp_path: Path) -> None:
    volume = read_ct(write_series(tmp_path, 6, lambda made, k: setattr(made, "KVP", (120, 140)[k // 3])))
    assert volume.flags == (VolumeFlag.MIXED_VOLTAGE,)


def test_a_slice_that_does_not_state_its_tube_voltage_stays(tmp_path: Path) -> None:
    volume = read_ct(write_series(tmp_path, 4, lambda made, k: setattr(made, "KVP", None if k == 1 else 120)))
    assert volume.voxels_hu.shape[0] == 4
    assert volume.flags == ()


@pytest.mark.parametrize(
    ("times", "is_flagged"),
    [
        (["115950", "120000", "120010", "120020.5"], False),
        (["120020.5", "120010", "120000", "115950"], False),
        (["120000", "120000", "120000", "120000"], False),
        (["120000.0", "120000.9", "120000.2", "120001.1"], False),
        (["120000", "120100", "120002", "120102"], True),
        (["120000", "120100", "120002", ""], True),
        (["", "", "", ""], False),
    ],
)
def test_slices_of_two_passes_among_each_other_are_flagged(
    tmp_path: Path, times: list[str], is_flagged: bool
) -> None:
    volume = read_ct(write_series(tmp_path, change=lambda made, k: setattr(made, "AcquisitionTime", times[k])))
    assert (VolumeFlag.OUT_OF_ORDER in volume.flags) == is_flagged


def test_a_scan_over_midnight_is_in_order(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        made.AcquisitionDate, made.AcquisitionTime = (("20260131", "235958"), ("20260201", "000002"))[k // 2]

    assert read_ct(write_series(tmp_path, change=change)).flags == ()


def test_more_parts_than_a_series_can_sensibly_have_are_refused_in_bounded_time() -> None:
    assert stacks_of([]) == []
    first = slice_image(dataset(0))
    images = [
        replace(first, orientation=(np.cos(angle), np.sin(angle), 0, -np.sin(angle), np.cos(angle), 0))
        for angle in np.linspace(0, 1, 3000)
    ]
    (stack,) = stacks_of(images)
    assert stack.problem is not None
    assert "too many orientations" in stack.problem


@pytest.mark.parametrize(
    ("keyword", "value", "reason"),
    [
        ("ImageOrientationPatient", [1, 0, 0, 0.5, 1, 0], "not two perpendicular unit vectors"),
        ("ImageOrientationPatient", [0, 0, 0, 0, 0, 0], "not two perpendicular unit vectors"),
        ("ImageOrientationPatient", [1, 0, 0], "its orientation has 3 numbers, expected 6"),
        ("ImageOrientationPatient", None, "its image has no orientation"),
        ("ImagePositionPatient", None, "its image has no position; export it again"),
        ("ImagePositionPatient", [0, 0, 1e9], "more than 100 m"),
        ("PixelSpacing", [0, 0.5], "is not between 0.01 and 100"),
        ("PixelSpacing", [-0.5, 0.5], "is not between 0.01 and 100"),
        ("PixelSpacing", None, "its image has no pixel spacing"),
    ],
)
def test_unusable_geometry_is_refused_by_name(tmp_path: Path, keyword: str, value: object, reason: str) -> None:
    write_series(tmp_path, change=lambda made, k: setattr(made, keyword, value))
    with pytest.raises(InputError, match=reason):
        read_ct(tmp_path)


def test_a_control_character_beside_a_number_is_no_blank(tmp_path: Path) -> None:
    damaged = write_series(tmp_path) / "001"
    content = damaged.read_bytes()
    assert content.count(b"\\32.0") == 1
    damaged.write_bytes(content.replace(b"\\32.0", b"\\\x0b2.0"))
    with pytest.raises(InputError, match=r"1 of 4 files \(\S+\): element \(0020,0032\) holds .*, not numbers"):
        read_ct(tmp_path)


def test_two_localizers_that_do_not_say_so_are_no_volume(tmp_path: Path) -> None:
    write_series(tmp_path / "two", 2, placed([[0, 0, 0], [0, 0, 20]], ImageType=["ORIGINAL", "PRIMARY"]))
    with pytest.raises(InputError, match="2 slices only; a volume needs 3 or more"):
        read_ct(tmp_path / "two")
    write_series(tmp_path / "apart", 3, placed([[0, 0, 0], [0, 0, 250], [0, 0, 500]]))
    with pytest.raises(InputError, match="lie 250 mm apart: localizers or single cuts"):
        read_ct(tmp_path / "apart")


def test_a_single_slice_is_no_volume(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="one slice only"):
        read_ct(write_series(tmp_path, 1))


@pytest.mark.parametrize(("count", "parts"), [(40, "more than 32"), (4, "4")])
@pytest.mark.parametrize(
    ("keyword", "told"),
    [("StudyInstanceUID", "studies"), ("FrameOfReferenceUID", "frames of reference"), ("PatientID", "patients")],
)
def test_what_every_file_was_given_for_itself_is_named(
    tmp_path: Path, keyword: str, told: str, count: int, parts: str
) -> None:
    """As programs leave it that take names away, or that write, file by file."""
    write_series(tmp_path, count, lambda made, k: setattr(made, keyword, f"1.2.{k}"))
    with pytest.raises(InputError, match=rf"it mixes too many {told} \({parts} parts of {count} images\)"):
        read_ct(tmp_path)


def test_of_a_series_in_which_all_is_mixed_three_things_are_named(tmp_path: Path) -> None:
    def other(made: Dataset, k: int) -> None:
        made.StudyInstanceUID = made.FrameOfReferenceUID = f"1.2.{k}"
        made.PatientID, made.PixelSpacing = f"P{k}", [1.0 + k / 10, 1.0]

    write_series(tmp_path, 40, other)
    with pytest.raises(InputError, match=r"too many pixel spacings, frames of reference, studies \(more than 32"):
        read_ct(tmp_path)
