from pathlib import Path

import numpy as np
import pytest
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate, encapsulate_extended, generate_frames
from pydicom.pixels.utils import pixel_array

from ronnaplan.ct import VolumeFlag, find_series, read_ct
from ronnaplan.errors import InputError
from tests.ct.makers import compress, enhanced, pattern, save, write_series

KINDS = {
    "1.2.840.10008.5.1.4.1.1.7": ("OT", "a secondary capture"),
    "1.2.840.10008.5.1.4.1.1.88.67": ("SR", "a radiation dose report (SR)"),
    "1.2.840.10008.5.1.4.1.1.88.22": ("SR", "a structured report (SR)"),
    "1.2.840.10008.5.1.4.1.1.481.3": ("RTSTRUCT", "a structure set (RTSTRUCT)"),
    "1.2.840.10008.5.1.4.1.1.481.2": ("RTDOSE", "a radiotherapy dose (RTDOSE)"),
    "1.2.840.10008.5.1.4.1.1.4": ("MR", "the modality is MR, not CT"),
    "1.2.840.10008.5.1.4.1.1.128": ("PT", "the modality is PT, not CT"),
    "1.2.840.10008.5.1.4.1.1.11.1": ("PR", "a presentation state"),
}


def enhanced_file(folder: Path, made: object, name: str = "multi") -> Path:
    save(made, folder / name)  # type: ignore[arg-type]
    return folder / name


@pytest.mark.parametrize("sop_class", list(KINDS))
def test_what_is_no_ct_is_listed_with_the_reason(tmp_path: Path, sop_class: str) -> None:
    modality, reason = KINDS[sop_class]

    def change(made: Dataset, k: int) -> None:
        made.SOPClassUID, made.Modality, made.SeriesInstanceUID = sop_class, modality, "1.2.3.8"

    write_series(tmp_path, 1, change, prefix="other")
    write_series(tmp_path)
    found = find_series(tmp_path)
    (other,) = [series for series in found.series if series.key == "1.2.3.8"]
    assert reason in other.problems[0]
    assert found.choose().key == "1.2.3.2"


def test_a_localizer_within_the_series_is_set_apart(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        if k == 0:
            made.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]

    volume = read_ct(write_series(tmp_path, change=change))
    assert volume.voxels_hu.shape[0] == 3
    assert volume.flags == (VolumeFlag.IMAGES_LEFT_OUT,)


@pytest.mark.parametrize(
    ("keyword", "value", "reason"),
    [
        ("RescaleType", "HU_MOD", "its values are in 'HU_MOD'"),
        ("RescaleSlope", None, "no rescale slope and intercept"),
        ("RescaleSlope", 0, "cannot be right"),
        ("RescaleIntercept", 1e9, "cannot be right"),
        ("SamplesPerPixel", 3, "a colour picture"),
        ("PhotometricInterpretation", "PALETTE COLOR", "photometric interpretation is PALETTE COLOR"),
        ("BitsAllocated", 12, "its pixels take 12 bits"),
        ("HighBit", 14, "expected the low bits"),
        ("PixelRepresentation", None, "its header gives no pixel representation"),
        ("PixelRepresentation", 2, r"pixel representation is 2, expected 0 \(unsigned\) or 1 \(signed\)"),
        ("PixelRepresentation", 0xFFFF, "pixel representation is 65535"),
        ("BitsStored", None, "its header gives no bits stored"),
        ("HighBit", None, "its header gives no high bit"),
        ("BitsAllocated", None, "its header gives no bits allocated"),
        ("SamplesPerPixel", None, "its header gives no samples per pixel"),
        ("PhotometricInterpretation", None, "its header gives no photometric interpretation"),
        ("RescaleSlope", [1, 2], "it has 2 rescale slopes and 1 intercepts"),
        ("RescaleIntercept", [-1024, 0], "it has 1 rescale slopes and 2 intercepts"),
        ("Rows", 4000, "it declares 80000 bytes of pixels but holds 160"),
        ("PixelData", bytes(162), "it declares 160 bytes of pixels but holds 162"),
        ("NumberOfFrames", 4, "4 frames without saying where each one is|declares 640 bytes"),
        ("PixelData", None, "it holds no pixels"),
    ],
)
def test_images_that_are_not_plain_hu_slices_are_refused_by_name(
    tmp_path: Path, keyword: str, value: object, reason: str
) -> None:
    def change(made: Dataset, k: int) -> None:
        if value is None:
            delattr(made, keyword)
        else:
            setattr(made, keyword, value)

    with pytest.raises(InputError, match=reason):
        read_ct(write_series(tmp_path, change=change))


def test_a_modality_lut_that_some_program_left_empty_is_none(tmp_path: Path) -> None:
    write_series(tmp_path, change=lambda made, k: setattr(made, "ModalityLUTSequence", []))
    assert read_ct(tmp_path).voxels_hu[0, 0, 0] == -1024
    write_series(tmp_path, change=lambda made, k: setattr(made, "ModalityLUTSequence", [Dataset()]))
    with pytest.raises(InputError, match="its values need a modality LUT"):
        read_ct(tmp_path)


def test_one_damaged_slice_makes_its_series_unusable_rather_than_shorter(tmp_path: Path) -> None:
    write_series(tmp_path, change=lambda made, k: delattr(made, "RescaleSlope") if k == 3 else None)
    with pytest.raises(InputError, match=r"1 of 4 files \(\S+\): it has no rescale slope"):
        read_ct(tmp_path)


def test_a_multi_frame_ct_is_read_from_its_functional_groups(tmp_path: Path) -> None:
    heights = [36, 30, 34, 32]

    def change(groups: Dataset, k: int) -> None:
        groups.PlanePositionSequence[0].ImagePositionPatient = [-10, -20, heights[k]]

    volume = read_ct(enhanced_file(tmp_path, enhanced(4, change)))
    assert volume.grid.slice_positions_mm.tolist() == [30, 32, 34, 36]
    assert np.array_equal(volume.voxels_hu, np.stack([pattern(k) for k in (1, 3, 2, 0)]) - 1024)
    assert np.allclose(volume.grid.positions_mm(np.array([0, 1, 1.0])), [-10 + 0.75, -20 + 0.5, 30])


@pytest.mark.parametrize(("frames", "noise"), [(9, 0), (2, 0), (9, 30_000)])
def test_a_deflated_ct_of_which_each_frame_would_unpack_much_is_refused(
    tmp_path: Path, frames: int, noise: int
) -> None:
    """Small ones are read. 300 frames of 512 x 512 took many minutes, or were refused for too long a header."""
    made = enhanced(frames)
    made.Rows = made.Columns = 1024
    values = np.random.default_rng(0).integers(0, noise + 1, (frames, 1024, 1024))
    made.PixelData = values.astype(np.int16).tobytes()
    save(made, tmp_path / "multi", "1.2.840.10008.1.2.1.99")
    if frames == 2:
        (series,) = find_series(tmp_path).series
        assert series.problems == ("it has 2 slices only; a volume needs 3 or more",)
        return
    with pytest.raises(InputError, match="it is deflated as a whole, and too large"):
        read_ct(tmp_path)


def own_rescale(groups: Dataset, k: int) -> None:
    values = Dataset()
    values.RescaleSlope, values.RescaleIntercept, values.RescaleType = 1, -1000 - k, "HU"
    groups.PixelValueTransformationSequence = [values]


def test_each_frame_may_have_a_rescale_of_its_own(tmp_path: Path) -> None:
    made = enhanced(4, own_rescale)
    del made.SharedFunctionalGroupsSequence[0].PixelValueTransformationSequence
    volume = read_ct(enhanced_file(tmp_path, made))
    assert volume.voxels_hu[:, 0, 0].tolist() == [100 * k - 1000 - k for k in range(4)]


def test_a_rescale_given_for_all_frames_and_otherwise_for_each_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"element \(0028,1052\) twice, with two values"):
        read_ct(enhanced_file(tmp_path, enhanced(4, own_rescale)))


@pytest.mark.parametrize(("second_kv", "kept_kv"), [(140, None), (80, 80.0)])
def test_two_tubes_may_make_one_image(second_kv: int, kept_kv: float | None, tmp_path: Path) -> None:
    def change(groups: Dataset, k: int) -> None:
        groups.CTXRayDetailsSequence = [Dataset(), Dataset()]
        for details, voltage_kv in zip(groups.CTXRayDetailsSequence, (80, second_kv), strict=True):
            details.KVP, details.FocalSpots = voltage_kv, 0.8

    path = enhanced_file(tmp_path, enhanced(4, change))
    (series,) = find_series(path).usable
    assert series.stack is not None
    assert {image.tube_voltage_kv for image in series.stack.slices} == {kept_kv}
    assert read_ct(path).voxels_hu[:, 0, 0].tolist() == [100 * k - 1024 for k in range(4)]


def test_a_functional_group_of_two_items_is_refused(tmp_path: Path) -> None:
    def change(groups: Dataset, k: int) -> None:
        other = Dataset()
        other.ImagePositionPatient = [0, 0, 0]
        groups.PlanePositionSequence.append(other)

    with pytest.raises(InputError, match=r"group \(0020,9113\) has 2 items, expected one"):
        read_ct(enhanced_file(tmp_path, enhanced(4, change)))
    made = enhanced(4)
    made.SharedFunctionalGroupsSequence.append(made.SharedFunctionalGroupsSequence[0])
    with pytest.raises(InputError, match="2 sets of shared functional groups"):
        read_ct(enhanced_file(tmp_path, made, "shared"))


def test_several_stacks_of_a_multi_frame_ct_are_offered_apart(tmp_path: Path) -> None:
    path = enhanced_file(tmp_path, enhanced(6, stacks=2))
    with pytest.raises(InputError, match="2 usable series"):
        read_ct(path)
    assert read_ct(path, "1.2.3.2#2").grid.slice_positions_mm.tolist() == [36, 38, 40]


def test_a_multi_frame_ct_that_describes_fewer_frames_than_it_holds_is_refused(tmp_path: Path) -> None:
    made = enhanced(4)
    del made.PerFrameFunctionalGroupsSequence[3]
    with pytest.raises(InputError, match="declares 4 frames but describes 3"):
        read_ct(enhanced_file(tmp_path, made))


def test_more_frames_than_any_scan_has_are_refused(tmp_path: Path) -> None:
    made = enhanced(4)
    made.NumberOfFrames, made.Rows, made.Columns = 300_000, 1, 1
    made.PixelData = bytes(600_000)
    with pytest.raises(InputError, match="declares 300000 frames, more than 20000"):
        read_ct(enhanced_file(tmp_path, made))


@pytest.mark.parametrize("syntax", ["1.2.840.10008.1.2.5", "1.2.840.10008.1.2.4.80"])
def test_compressed_frames_are_told_apart(tmp_path: Path, syntax: str) -> None:
    volume = read_ct(enhanced_file(tmp_path, compress(enhanced(5), syntax, tmp_path)))
    assert np.array_equal(volume.voxels_hu, np.stack([pattern(k) for k in range(5)]) - 1024)


@pytest.mark.parametrize("syntax", ["1.2.840.10008.1.2.4.70", "1.2.840.10008.1.2.4.80"])
@pytest.mark.parametrize("has_table", [True, False])
def test_frames_of_several_fragments_are_found_by_a_table_or_by_where_images_begin(
    tmp_path: Path, syntax: str, has_table: bool
) -> None:
    """Writers may leave the table empty."""
    made = compress(enhanced(3), syntax, tmp_path)
    frames = list(generate_frames(made.PixelData, number_of_frames=3))
    made.PixelData = encapsulate(frames, fragments_per_frame=3, has_bot=has_table)
    volume = read_ct(enhanced_file(tmp_path, made))
    assert np.array_equal(volume.voxels_hu, np.stack([pattern(k) for k in range(3)]) - 1024)


def test_fragments_that_nothing_shares_out_among_frames_are_refused(tmp_path: Path) -> None:
    made = compress(enhanced(3), "1.2.840.10008.1.2.5", tmp_path)
    frames = list(generate_frames(made.PixelData, number_of_frames=3))
    made.PixelData = encapsulate(frames, fragments_per_frame=2, has_bot=True)
    read_ct(enhanced_file(tmp_path, made, "with table"))
    made.PixelData = encapsulate(frames, fragments_per_frame=2, has_bot=False)
    with pytest.raises(InputError, match="cannot be told apart"):
        read_ct(enhanced_file(tmp_path, made, "without"))
    made = compress(enhanced(4), "1.2.840.10008.1.2.4.80", tmp_path)
    made.PixelData = encapsulate(list(generate_frames(made.PixelData, number_of_frames=4)), has_bot=False)
    made.NumberOfFrames = 3
    del made.PerFrameFunctionalGroupsSequence[3]
    with pytest.raises(InputError, match="3 compressed frames cannot be told apart"):
        read_ct(enhanced_file(tmp_path, made, "one frame too many"))


def test_an_offset_table_that_puts_frames_in_another_order_than_they_lie_in_is_refused(tmp_path: Path) -> None:
    """Some readers go by the table, others by the order, and each frame has its place by its number."""
    made = compress(enhanced(3), "1.2.840.10008.1.2.4.80", tmp_path)
    content = encapsulate(list(generate_frames(made.PixelData, number_of_frames=3)), has_bot=True)
    offsets = np.frombuffer(content[8:20], "<u4")
    for order, is_read in (((0, 1, 2), True), ((1, 2, 0), False)):
        made.PixelData = content[:8] + offsets[list(order)].tobytes() + content[20:]
        path = enhanced_file(tmp_path, made, f"table {order[0]}")
        if is_read:
            assert np.array_equal(read_ct(path).voxels_hu[2], pattern(2) - 1024)
            continue
        assert np.array_equal(pixel_array(path, index=2), pattern(0))
        with pytest.raises(InputError, match="3 compressed frames cannot be told apart"):
            read_ct(path)


def test_an_extended_offset_table_in_another_order_is_refused_too(tmp_path: Path) -> None:
    made = compress(enhanced(3), "1.2.840.10008.1.2.4.80", tmp_path)
    frames = list(generate_frames(made.PixelData, number_of_frames=3))
    made.PixelData, *tables = encapsulate_extended(frames)
    for order, is_read in (([0, 1, 2], True), ([1, 2, 0], False)):
        offsets, lengths = (np.frombuffer(table, "<u8")[order].tobytes() for table in tables)
        made.ExtendedOffsetTable, made.ExtendedOffsetTableLengths = offsets, lengths
        path = enhanced_file(tmp_path, made, f"table {order[0]}")
        assert np.array_equal(pixel_array(path, index=2), pattern(order[2]))
        if is_read:
            assert np.array_equal(read_ct(path).voxels_hu[2], pattern(2) - 1024)
            continue
        with pytest.raises(InputError, match="extended offset table puts frames in another order"):
            read_ct(path)


@pytest.mark.parametrize("counted_from", [None, 1000], ids=["no table", "table of other places"])
def test_frames_of_one_fragment_each_are_read_whatever_the_offset_table_says_that_is_none_of_them(
    counted_from: int | None, tmp_path: Path
) -> None:
    """How RLE images begin tells nothing; writers leave the table empty, or count from elsewhere."""
    made = compress(enhanced(3), "1.2.840.10008.1.2.5", tmp_path)
    frames = list(generate_frames(made.PixelData, number_of_frames=3))
    made.PixelData = encapsulate(frames, has_bot=counted_from is not None)
    if counted_from is not None:
        places = np.frombuffer(made.PixelData[8:20], "<u4") + np.uint32(counted_from)
        made.PixelData = made.PixelData[:8] + places.tobytes() + made.PixelData[20:]
    volume = read_ct(enhanced_file(tmp_path, made))
    assert np.array_equal(volume.voxels_hu, np.stack([pattern(k) for k in range(3)]) - 1024)


@pytest.mark.parametrize("unit", ["HU", "US", "Hounsfield", "hounsfield units", None])
def test_hounsfield_units_by_any_name_are_read(tmp_path: Path, unit: str | None) -> None:
    def named(made: Dataset, k: int) -> None:
        if unit is not None:
            made.RescaleType = unit

    assert read_ct(write_series(tmp_path, change=named)).voxels_hu.min() == -1024


@pytest.mark.parametrize(("kept", "total", "lacks"), [((1, 2), 2, False), ((1,), 2, True), ((2,), None, True)])
def test_files_of_one_image_of_which_some_are_not_there_are_flagged(
    kept: tuple[int, ...], total: int | None, lacks: bool, tmp_path: Path
) -> None:
    """Frames may be cut into several files (a concatenation): those of one end could be lost without a word."""
    for number in kept:
        made = enhanced(3, lambda groups, k, n=number: _moved(groups, 6.0 * n))  # type: ignore[misc]
        made.SOPInstanceUID = f"1.2.3.8.{number}"
        made.ConcatenationUID, made.InConcatenationNumber = "1.2.3.7", number
        if total is not None:
            made.InConcatenationTotalNumber = total
        save(made, tmp_path / f"{number}")
    volume = read_ct(tmp_path)
    assert volume.voxels_hu.shape[0] == 3 * len(kept)
    assert volume.flags == ((VolumeFlag.MISSING_SLICE,) if lacks else ())


def _moved(groups: Dataset, z_mm: float) -> None:
    position = groups.PlanePositionSequence[0]
    position.ImagePositionPatient = [-10, -20, float(position.ImagePositionPatient[2]) + z_mm]
