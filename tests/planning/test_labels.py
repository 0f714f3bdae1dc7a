"""Label maps are read onto the scan's own voxels, whatever the order of their axes; any other grid is refused."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.encaps import encapsulate
from pydicom.pixels.utils import pack_bits
from pydicom.sequence import Sequence
from pydicom.uid import UID, ExplicitVRLittleEndian, JPEGLosslessSV1, JPEGLSLossless, RLELossless, generate_uid

from ronnaplan.ct import CTVolume, SliceGrid, VolumeFlag, read_ct
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.planning import read_label_map
from ronnaplan.planning.labels import SEGMENTATION_STORAGE
from tests.ct.test_rounded import heights
from tests.ct.test_rounded import written as rounded_series
from tests.long import few_or_all
from tests.planning.heads import scanned


@pytest.fixture
def volume() -> CTVolume:
    """A small part of the oblique scan: 20 x 30 x 26 voxels."""
    whole = scanned("oblique").volume
    corner = whole.grid.positions_mm(np.array([30.0, 60.0, 80.0]))
    origins = corner + whole.grid.origins_mm[30:50] - whole.grid.origins_mm[30]
    return replace(
        whole, voxels_hu=whole.voxels_hu[30:50, 60:90, 80:106], grid=replace(whole.grid, origins_mm=origins)
    )


@pytest.fixture
def mask(volume: CTVolume) -> NDArray[np.bool_]:
    return np.random.default_rng(3).random(volume.voxels_hu.shape) < 0.05


def write_image(path: Path, values: NDArray[Any], grid: SliceGrid, flips: tuple[int, int, int]) -> Path:
    """Write (K, J, I) values, each axis turned round where ``flips`` says -1."""
    turned = values[tuple(slice(None, None, flip) for flip in flips)]
    first = [0.0 if flip > 0 else count - 1.0 for flip, count in zip(flips, values.shape, strict=True)]
    slice_step = grid.origins_mm[1] - grid.origins_mm[0]
    steps = [grid.column_step_mm * flips[2], grid.row_step_mm * flips[1], slice_step * flips[0]]
    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(turned))
    image.SetOrigin(grid.positions_mm(np.array(first)).tolist())
    lengths = [float(np.linalg.norm(step)) for step in steps]
    image.SetSpacing(lengths)
    image.SetDirection(np.column_stack([s / n for s, n in zip(steps, lengths, strict=True)]).ravel().tolist())
    SimpleITK.WriteImage(image, str(path))
    return path


@pytest.mark.parametrize("flips", [(1, 1, 1), (1, -1, -1), (-1, -1, 1), (-1, 1, -1)])
def test_a_nifti_map_falls_on_its_voxels(
    volume: CTVolume, mask: NDArray[np.bool_], flips: tuple[int, int, int], tmp_path: Path
) -> None:
    path = write_image(tmp_path / "vessels.nii.gz", mask.astype(np.uint8), volume.grid, flips)
    (name, read), *others = read_label_map(path, volume).items()
    assert name == "vessels"
    assert not others
    np.testing.assert_array_equal(read, mask)


def test_axes_may_come_in_another_order(volume: CTVolume, mask: NDArray[np.bool_], tmp_path: Path) -> None:
    grid = volume.grid
    steps = [grid.origins_mm[1] - grid.origins_mm[0], grid.column_step_mm, grid.row_step_mm]
    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(mask.astype(np.uint8).transpose(1, 2, 0)))
    image.SetOrigin(grid.origins_mm[0].tolist())
    lengths = [float(np.linalg.norm(step)) for step in steps]
    image.SetSpacing(lengths)
    image.SetDirection(np.column_stack([s / n for s, n in zip(steps, lengths, strict=True)]).ravel().tolist())
    SimpleITK.WriteImage(image, str(tmp_path / "map.nrrd"))
    np.testing.assert_array_equal(read_label_map(tmp_path / "map.nrrd", volume)["map"], mask)


def test_each_value_is_a_region(volume: CTVolume, tmp_path: Path) -> None:
    values = np.zeros(volume.voxels_hu.shape, dtype=np.uint8)
    values[2, 3, 4], values[5, 6, 7] = 1, 7
    regions = read_label_map(write_image(tmp_path / "brain.nii", values, volume.grid, (1, 1, 1)), volume)
    assert {name: np.argwhere(region).tolist() for name, region in regions.items()} == {
        "brain 1": [[2, 3, 4]],
        "brain 7": [[5, 6, 7]],
    }


def test_what_was_drawn_on_slices_of_rounded_positions_is_read_on_the_evened_ones(tmp_path: Path) -> None:
    """Segmentations name the positions as they are written, along both axes of a tilted scan 0.05 mm off."""
    heights_mm = heights(0.6371)
    scan = read_ct(rounded_series(tmp_path / "scan", heights_mm, sideways=0.31))
    assert VolumeFlag.ROUNDED in scan.flags
    marked = np.random.default_rng(1).random(scan.voxels_hu.shape) < 0.1
    as_written = scan.grid.origins_mm.copy()
    as_written[:, 1:] = np.round(np.stack([0.31 * heights_mm, heights_mm], axis=1), 1)
    drawn = replace(scan, grid=replace(scan.grid, origins_mm=as_written))
    made = segmentation(drawn, {"drawn": marked}, str(scan.frame.uid))
    made.save_as(tmp_path / "seg.dcm", enforce_file_format=True)
    np.testing.assert_array_equal(read_label_map(tmp_path / "seg.dcm", scan)["drawn"], marked)


def test_another_grid_is_refused(volume: CTVolume, mask: NDArray[np.bool_], tmp_path: Path) -> None:
    values = mask.astype(np.uint8)
    shifted = replace(volume.grid, origins_mm=volume.grid.origins_mm + np.array([0.3, 0, 0]))
    finer = replace(volume.grid, row_step_mm=volume.grid.row_step_mm * 0.99)
    for grid, part in (
        (shifted, values),
        (finer, values),
        (volume.grid, values[:-1]),
        (volume.grid, values[:, :-2]),
    ):
        path = write_image(tmp_path / "map.nii.gz", part, grid, (1, 1, 1))
        with pytest.raises(InputError, match="another grid"):
            read_label_map(path, volume)


@pytest.mark.parametrize("flips", [(1, 1, 1), (1, -1, -1), (-1, 1, -1)])
def test_what_slicer_crops_to_its_segments_falls_on_their_voxels(
    volume: CTVolume, mask: NDArray[np.bool_], flips: tuple[int, int, int], tmp_path: Path
) -> None:
    """`test_another_grid_is_refused` for a part of the grid in a file of any other kind."""
    part = slice(3, 17), slice(2, 25), slice(5, 20)
    marked = np.zeros_like(mask)
    marked[part] = mask[part]
    corner = volume.grid.positions_mm(np.array([3.0, 2.0, 5.0])) - volume.grid.origins_mm[3]
    grid = replace(volume.grid, origins_mm=volume.grid.origins_mm[3:17] + corner)
    path = write_image(tmp_path / "vessels.seg.nrrd", mask[part].astype(np.uint8), grid, flips)
    np.testing.assert_array_equal(read_label_map(path, volume)["vessels"], marked)
    beyond = replace(grid, origins_mm=grid.origins_mm - 6 * grid.column_step_mm)
    for other in (beyond, replace(grid, origins_mm=grid.origins_mm + 0.3 * grid.row_step_mm)):
        write_image(path, mask[part].astype(np.uint8), other, flips)
        with pytest.raises(InputError, match="another grid"):
            read_label_map(path, volume)


def test_an_empty_map_is_refused(volume: CTVolume, tmp_path: Path) -> None:
    empty = np.zeros(volume.voxels_hu.shape, dtype=np.uint8)
    with pytest.raises(InputError, match="marks no voxel"):
        read_label_map(write_image(tmp_path / "map.nii", empty, volume.grid, (1, 1, 1)), volume)


def segmentation(volume: CTVolume, masks: dict[str, NDArray[np.bool_]], frame_uid: str) -> Dataset:
    """A binary SEG (DICOM PS3.3 A.51) with a frame for each slice that a segment touches."""
    grid = volume.grid
    dataset = Dataset()
    dataset.SOPClassUID, dataset.SOPInstanceUID = SEGMENTATION_STORAGE, generate_uid()
    dataset.Modality, dataset.FrameOfReferenceUID, dataset.SegmentationType = "SEG", frame_uid, "BINARY"
    dataset.Rows, dataset.Columns = volume.voxels_hu.shape[1:]
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation, dataset.PixelRepresentation = 1, "MONOCHROME2", 0
    dataset.BitsAllocated = dataset.BitsStored = 1
    dataset.HighBit = 0
    orientation, measures, shared = Dataset(), Dataset(), Dataset()
    rows_and_columns = [*(grid.column_step_mm / grid.column_spacing_mm), *(grid.row_step_mm / grid.row_spacing_mm)]
    orientation.ImageOrientationPatient = [f"{value:.10f}" for value in rows_and_columns]
    measures.PixelSpacing = [f"{grid.row_spacing_mm:.8f}", f"{grid.column_spacing_mm:.8f}"]
    shared.PlaneOrientationSequence, shared.PixelMeasuresSequence = Sequence([orientation]), Sequence([measures])
    dataset.SharedFunctionalGroupsSequence = Sequence([shared])
    segments, frames, pixels = [], [], []
    for number, (label, mask) in enumerate(masks.items(), start=1):
        segment = Dataset()
        segment.SegmentNumber, segment.SegmentLabel = number, label
        segments.append(segment)
        for k in np.flatnonzero(mask.any(axis=(1, 2))):
            position, identity, frame = Dataset(), Dataset(), Dataset()
            position.ImagePositionPatient = [f"{value:.8f}" for value in grid.origins_mm[k]]
            identity.ReferencedSegmentNumber = number
            frame.PlanePositionSequence, frame.SegmentIdentificationSequence = (
                Sequence([position]),
                Sequence([identity]),
            )
            frames.append(frame)
            pixels.append(mask[k])
    dataset.SegmentSequence, dataset.PerFrameFunctionalGroupsSequence = Sequence(segments), Sequence(frames)
    dataset.NumberOfFrames = len(frames)
    dataset.PixelData = pack_bits(np.stack(pixels).astype(np.uint8).ravel(), pad=True)
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.file_meta.MediaStorageSOPClassUID = UID(SEGMENTATION_STORAGE)
    dataset.file_meta.MediaStorageSOPInstanceUID = dataset.SOPInstanceUID
    return dataset


def test_a_dicom_seg_falls_on_its_voxels(volume: CTVolume, mask: NDArray[np.bool_], tmp_path: Path) -> None:
    mask[7:12] = False
    other = np.roll(mask, 3, axis=1)
    path = tmp_path / "seg.dcm"
    segmentation(volume, {"artery": mask, "vein": other}, "1.2.3").save_as(path, enforce_file_format=True)
    regions = read_label_map(path, volume)
    np.testing.assert_array_equal(regions["artery"], mask)
    np.testing.assert_array_equal(regions["vein"], other)


def test_what_all_frames_share_is_said_once(volume: CTVolume, mask: NDArray[np.bool_], tmp_path: Path) -> None:
    mask[:4], mask[5:] = False, False
    dataset = segmentation(volume, {"artery": mask}, str(volume.frame.uid))
    (groups,), (shared,) = dataset.PerFrameFunctionalGroupsSequence, dataset.SharedFunctionalGroupsSequence
    shared.update(groups)
    dataset.PerFrameFunctionalGroupsSequence = Sequence([Dataset()])
    dataset.save_as(tmp_path / "seg.dcm", enforce_file_format=True)
    np.testing.assert_array_equal(read_label_map(tmp_path / "seg.dcm", volume)["artery"], mask)


def test_segments_of_one_name_are_one_region(volume: CTVolume, mask: NDArray[np.bool_], tmp_path: Path) -> None:
    """Of vessels in one slice only the last was kept clear of."""
    other = np.roll(mask, 3, axis=2) & ~mask
    dataset = segmentation(volume, {"vessel": mask, "another": other}, str(volume.frame.uid))
    dataset.SegmentSequence[1].SegmentLabel = "vessel"
    dataset.save_as(tmp_path / "seg.dcm", enforce_file_format=True)
    assert (other.any(axis=(1, 2)) & mask.any(axis=(1, 2))).any()
    found = read_label_map(tmp_path / "seg.dcm", volume)
    assert list(found) == ["vessel"]
    np.testing.assert_array_equal(found["vessel"], mask | other)


def test_a_dicom_seg_of_another_frame_or_grid_is_refused(
    volume: CTVolume, mask: NDArray[np.bool_], tmp_path: Path
) -> None:
    path = tmp_path / "seg.dcm"
    segmentation(volume, {"artery": mask}, "1.2.4").save_as(path, enforce_file_format=True)
    with pytest.raises(FrameMismatchError, match=r"1\.2\.4"):
        read_label_map(path, volume)
    grid = volume.grid
    for step_mm in (0.4 * grid.normal, -3 * grid.column_step_mm, grid.row_step_mm):  # or around another center
        moved = replace(volume, grid=replace(grid, origins_mm=grid.origins_mm + step_mm))
        segmentation(moved, {"artery": mask}, "1.2.3").save_as(path, enforce_file_format=True)
        with pytest.raises(InputError, match="off the scan's slices"):
            read_label_map(path, volume)


def test_what_is_no_label_map_is_refused(volume: CTVolume, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no DICOM")
    for path in (tmp_path / "notes.txt", tmp_path / "absent.dcm", tmp_path / "absent.nii"):
        with pytest.raises(InputError):
            read_label_map(path, volume)
    damaged = segmentation(volume, {"artery": np.ones(volume.voxels_hu.shape, dtype=np.bool_)}, "1.2.3")
    del damaged.PerFrameFunctionalGroupsSequence
    damaged.save_as(tmp_path / "seg.dcm", enforce_file_format=True)
    with pytest.raises(InputError, match="not a complete DICOM SEG"):
        read_label_map(tmp_path / "seg.dcm", volume)


def test_a_pipe_in_a_label_map_s_place_is_not_waited_for(volume: CTVolume, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "map")
    with pytest.raises(InputError, match="no regular file"):
        read_label_map(tmp_path / "map", volume)


@few_or_all("cases", 120, 400)
def test_a_damaged_dicom_seg_is_refused_in_one_line(
    volume: CTVolume, mask: NDArray[np.bool_], tmp_path: Path, cases: int
) -> None:
    """Many ended in a traceback of pydicom's, and a compressed one the whole process."""
    path, rng = tmp_path / "seg.dcm", np.random.default_rng(11)
    dataset = segmentation(volume, {"artery": mask}, "1.2.3")
    contents = []
    for syntax in (None, RLELossless, JPEGLSLossless):
        if syntax is not None:
            dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit = 8, 8, 7
            dataset.SegmentationType = "FRACTIONAL"
            dataset.PixelData = (mask[mask.any(axis=(1, 2))] * np.uint8(255)).tobytes()
            dataset["PixelData"].VR = "OB"
            dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
            dataset.compress(syntax, encoding_plugin="pydicom" if syntax == RLELossless else "pyjpegls")
        dataset.save_as(path, enforce_file_format=True)
        np.testing.assert_array_equal(read_label_map(path, volume)["artery"], mask)
        contents.append(path.read_bytes())
    told = []
    for turn in range(cases):
        content = bytearray(contents[turn % 3])
        place = int(rng.integers(128, len(content)))
        content[place : place + int(rng.integers(2) * 9)] = rng.bytes(int(rng.integers(9)))
        path.write_bytes(content)
        try:
            read_label_map(path, volume)
        except (InputError, FrameMismatchError) as error:
            told.append(str(error))
    assert len(told) > cases // 4
    assert all(map(str.isprintable, told))


def test_a_dicom_seg_compressed_as_no_scan_may_be_is_refused(
    volume: CTVolume, mask: NDArray[np.bool_], tmp_path: Path
) -> None:
    dataset = segmentation(volume, {"artery": mask}, "1.2.3")
    dataset.file_meta.TransferSyntaxUID = JPEGLosslessSV1  # left to GDCM, which may end the process
    dataset.PixelData = encapsulate([b"\xff\x0a" * 9] * dataset.NumberOfFrames)
    dataset["PixelData"].VR = "OB"
    dataset.save_as(tmp_path / "seg.dcm", enforce_file_format=True)
    with pytest.raises(InputError, match=r"4\.70, which is not read for a SEG; export it uncompressed"):
        read_label_map(tmp_path / "seg.dcm", volume)
