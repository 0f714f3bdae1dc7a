"""No-go regions from label maps: NIfTI (NRRD, MetaImage) or DICOM SEG, on the scan's own grid.

A label map is never resampled: one drawn on another grid, or in another frame of reference, is refused. So is one on a
part of the scan's grid, as nobody may have looked at the rest; Slicer's own segmentations are read, which it stores no
larger than what they mark.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import read_ct
from ronnaplan.ct.frames import PLAIN_SYNTAXES
from ronnaplan.ct.grid import SliceGrid
from ronnaplan.ct.images import is_image_file
from ronnaplan.ct.uids import PLUGINS
from ronnaplan.ct.volume import WAYS_TO_A_VOLUME, CTVolume
from ronnaplan.errors import FrameMismatchError, InputError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.text import printable
from ronnaplan.untrusted import require_file

GRID_TOLERANCE_MM = 0.1
"""Voxel centers of scan and label map agree within this: slices may be written to 0.1 mm, each up to half of that off
along two axes, and the scan has them evened (`VolumeFlag.ROUNDED`)."""

CROPPED = ".seg.nrrd"
"""How the names of files end that Slicer crops to what they mark."""

SEGMENTATION_STORAGE = "1.2.840.10008.5.1.4.1.1.66.4"

Masks = dict[str, NDArray[np.bool_]]


def read_label_map(path: str | os.PathLike[str], volume: CTVolume) -> Masks:
    """Return the regions of a label map by name, each a mask (K, J, I) of ``volume``'s voxels.

    Every value but 0 is a region. Raises `FrameMismatchError` for another frame of reference and `InputError` for
    another grid, an empty map, or a file that is neither an image file nor a DICOM SEG.
    """
    check_type(path, (str, os.PathLike), "the path of the label map", "give the path of a file")
    check_type(volume, CTVolume, "the volume", WAYS_TO_A_VOLUME)
    source = Path(path)
    masks = _from_image(source, volume) if is_image_file(source) else _from_seg(source, volume)
    masks = {name: mask for name, mask in masks.items() if mask.any()}
    if not masks:
        raise InputError(f"{source} marks no voxel; expected a label map with values above 0")
    return masks


def _from_image(path: Path, volume: CTVolume) -> Masks:
    labels = read_ct(path)
    values = np.zeros(volume.voxels_hu.shape, dtype=labels.voxels_hu.dtype)
    offset, matrix = _fitted(labels.grid, labels.voxels_hu.shape, volume, path)
    corners = offset, offset + matrix @ (np.array(labels.voxels_hu.shape) - 1)
    part = tuple(map(slice, np.minimum(*corners), np.maximum(*corners) + 1))
    _put(values[part], labels.voxels_hu, (offset, matrix))
    stem = path.name.split(".")[0]
    numbers = [number for number in np.unique(values) if number != 0]
    if len(numbers) > 1000:
        raise InputError(f"{path} has {len(numbers)} different values; expected a label map, not an image")
    return {f"{stem} {number:g}" if len(numbers) > 1 else stem: values == number for number in numbers}


def _fitted(grid: SliceGrid, shape: tuple[int, ...], volume: CTVolume, path: Path) -> Any:
    """Return how the label map's axes run in the scan's, as whole (offset, matrix); else `InputError`."""
    last = np.array(shape, dtype=np.float64) - 1
    ends = np.array([[0, 0, 0], *np.diag(last)])
    places = volume.grid.indices(grid.positions_mm(ends))
    offset = np.rint(places[0]).astype(int)
    matrix = np.rint((places[1:] - places[0]) / np.maximum(last, 1)[:, None]).astype(int).T
    index = np.stack(np.meshgrid(*(np.unique(np.linspace(0, n, 9).round()) for n in last), indexing="ij"), -1)
    index = index.reshape(-1, 3)
    mapped = index @ matrix.T + offset
    apart = np.linalg.norm(volume.grid.positions_mm(mapped) - grid.positions_mm(index), axis=-1)
    inside = ((mapped >= 0) & (mapped < volume.voxels_hu.shape)).all()
    permuted = (np.abs(matrix).sum(axis=0) == 1).all() and (np.abs(matrix).sum(axis=1) == 1).all()
    whole = path.name.lower().endswith(CROPPED) or tuple(np.abs(matrix) @ shape) == volume.voxels_hu.shape
    if not (permuted and inside and whole and apart.max() <= GRID_TOLERANCE_MM):
        raise InputError(
            f"{path} is drawn on another grid ({' x '.join(map(str, shape))} voxels) than the scan "
            f"({' x '.join(map(str, volume.voxels_hu.shape))}); export the label map on the scan's own grid"
        )
    return offset, matrix


def _put(target: NDArray[Any], values: NDArray[Any], fitted: Any) -> None:
    """Copy ``values`` into ``target`` with its axes permuted and turned as ``fitted`` says."""
    _, matrix = fitted
    order = np.abs(matrix).argmax(axis=1)
    turned = values.transpose(order)
    signs = matrix[np.arange(3), order]
    target[...] = turned[tuple(slice(None, None, int(sign)) for sign in signs)]


def _from_seg(path: Path, volume: CTVolume) -> Masks:
    from pydicom import dcmread

    require_file(path, expected="a label map: NIfTI, NRRD, MetaImage or DICOM SEG")
    try:
        dataset = dcmread(path)
        names = ("SOPClassUID", "Modality", "FrameOfReferenceUID")
        sop_class, modality, frame_uid = (dataset.get(name) for name in names)
    except Exception as error:  # of what is damaged pydicom raises whatever it meets
        raise InputError(f"{path} is neither a NIfTI, NRRD or MetaImage file nor a readable DICOM SEG") from error
    if sop_class != SEGMENTATION_STORAGE:
        raise InputError(f"{path} is a DICOM {modality or 'object'}; expected a segmentation (SEG)")
    if frame_uid is None or str(frame_uid) != volume.frame.uid:
        raise FrameMismatchError(
            f"{path} is in frame of reference {frame_uid}, the scan in {volume.frame.uid}; "
            "use a segmentation of this scan"
        )
    try:
        return _segments(dataset, volume, path)
    except InputError:
        raise
    except Exception as error:  # likewise
        told = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(f"{path} is not a complete DICOM SEG ({printable(told)}); export it again") from error


def _segments(dataset: Any, volume: CTVolume, path: Path) -> Masks:
    frames = _pixels(dataset, path)
    frames = frames.reshape(-1, *frames.shape[-2:])
    names = {
        int(item.SegmentNumber): str(item.get("SegmentLabel", "") or f"segment {item.SegmentNumber}")
        for item in dataset.SegmentSequence
    }
    masks: Masks = {}
    shared = dataset.SharedFunctionalGroupsSequence[0]
    for pixels, groups in zip(frames, dataset.PerFrameFunctionalGroupsSequence, strict=True):
        number = int(_group(groups, shared, "SegmentIdentificationSequence").ReferencedSegmentNumber)
        mask = masks.setdefault(names[number], np.zeros(volume.voxels_hu.shape, dtype=np.bool_))
        k, matrix = _slice_of(groups, shared, pixels.shape, volume, path)
        drawn = np.zeros_like(mask[k : k + 1])
        _put(drawn, pixels[np.newaxis] > 0, (None, matrix))
        mask[k : k + 1] |= drawn  # several segments may have one name
    return masks


def _pixels(dataset: Any, path: Path) -> NDArray[Any]:
    """Return the values of all frames, decoded by what decodes a scan: others may end the process on a damaged one."""
    syntax = str(dataset.file_meta.TransferSyntaxUID)
    if syntax not in PLAIN_SYNTAXES.union(PLUGINS):
        raise InputError(
            f"{path} is compressed as {printable(syntax)}, which is not read for a SEG; export it uncompressed"
        )
    dataset.pixel_array_options(decoding_plugin=PLUGINS.get(syntax, ""))
    return np.asarray(dataset.pixel_array)


def _slice_of(groups: Any, shared: Any, shape: tuple[int, int], volume: CTVolume, path: Path) -> Any:
    """Return the scan's slice that a frame is drawn on and how the frame's axes run in it; else `InputError`."""
    position = _group(groups, shared, "PlanePositionSequence").ImagePositionPatient
    orientation = _group(groups, shared, "PlaneOrientationSequence").ImageOrientationPatient
    spacing = _group(groups, shared, "PixelMeasuresSequence").PixelSpacing
    origin = np.array(position, dtype=np.float64)
    along_row, down_column = np.array(orientation, dtype=np.float64).reshape(2, 3)
    column_step, row_step = along_row * float(spacing[1]), down_column * float(spacing[0])
    k = int(np.abs(volume.grid.slice_positions_mm - origin @ volume.grid.normal).argmin())
    corners = [[0, 0], [shape[0] - 1, 0], [0, shape[1] - 1], [shape[0] - 1, shape[1] - 1]]
    places = np.array([origin + j * row_step + i * column_step for j, i in corners])
    index = volume.grid.indices(places)
    index[:, 0] = k
    whole: FloatArray = np.rint(index)
    apart = np.linalg.norm(volume.grid.positions_mm(whole) - places, axis=-1).max()
    matrix = np.eye(3, dtype=int)
    steps = np.maximum(np.array(shape) - 1, 1)
    matrix[1:, 1] = np.rint((whole[1] - whole[0])[1:] / steps[0]).astype(int)
    matrix[1:, 2] = np.rint((whole[2] - whole[0])[1:] / steps[1]).astype(int)
    size = np.abs(matrix) @ [1, *shape]
    inside = ((whole >= 0) & (whole < volume.voxels_hu.shape)).all()  # it may be shifted by whole voxels
    if apart > GRID_TOLERANCE_MM or not inside or tuple(size[1:]) != volume.voxels_hu.shape[1:]:
        raise InputError(
            f"{path} has a frame that lies {apart:.2g} mm off the scan's slices, beside them or of another size; "
            "export the segmentation on the scan's own grid"
        )
    return k, matrix


def _group(groups: Any, shared: Any, name: str) -> Any:
    """Return a functional group of the frame itself, or the one shared by all frames."""
    return (getattr(groups, name, None) or getattr(shared, name))[0]
