"""From the images of a series to stacks of parallel slices, by positions and orientations alone.

Slice thickness, spacing and tilt tags never place a voxel; they are compared at most, and a contradiction is
flagged. What cannot be one stack is divided where the files say how, and refused where they do not.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from ronnaplan.bounds import FARTHEST_POINT_MM
from ronnaplan.ct.apart import OF_A_SLICE, PASSES, TUBE_VOLTAGES, share_plane, what_differs
from ronnaplan.ct.codecs import tells_loss
from ronnaplan.ct.copies import SAME_PLACE_TOLERANCE_MM, without_copies
from ronnaplan.ct.derived import flags_of
from ronnaplan.ct.grid import (
    PERPENDICULAR_TOLERANCE,
    PIXEL_SIZE_RANGE_MM,
    TILT_TOLERANCE_DEG,
    UNIFORM_SPACING_TOLERANCE_MM,
    SliceGrid,
)
from ronnaplan.ct.rounded import evened, is_spacing_cut
from ronnaplan.ct.slices import SliceImage
from ronnaplan.ct.values import Vector
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, unit

MULTIPLE_TOLERANCE: Final = 0.02
"""A gap within 2 % of a whole multiple of the usual gap tells of missing slices."""
SIDEWAYS_TOLERANCE_MM: Final = 0.05
"""Slice origins farther than this from the straight line through the others are shifted sideways."""
THICKNESS_TOLERANCE: Final = 0.01
"""Slices thicker than 1.01 times their spacing overlap."""
LEAST_SLICES: Final = 3
"""Two images may be two localizers; and two places tell nothing of an even spacing or a missing slice."""
LARGEST_GAP_MM: Final = 30.0
"""Slices farther apart (the usual gap) are no volume: localizers, or single cuts. Gaps of 20 mm are in use."""
OUT_OF_ORDER_S: Final = 1.0
"""Neighbouring slices whose times run back by more (against the volume's direction) are of different passes."""
UNEVEN_SHARE: Final = 0.25
"""Gaps that differ by more of the usual one lack slices, whatever their places were rounded to."""
MOST_MIXED: Final = 3
"""So many of the things that are unlike in a mixed series are told."""
MOST_PARTS: Final = 32
"""A series that falls into more parts than this, or into single images, is refused as a whole."""


@dataclass(frozen=True)
class Stack:
    """Parallel slices in ascending order along the normal, ready to be read.

    ``grid`` is None and ``problem`` says why where they cannot be placed. ``apart`` names what the stacks of its
    series differ in; empty where it is the only one.
    """

    slices: tuple[SliceImage, ...]
    grid: SliceGrid | None = None
    flags: tuple[VolumeFlag, ...] = ()
    problem: str | None = None
    apart: tuple[str, ...] = ()

    def flagged(self, flag: VolumeFlag) -> Stack:
        """Return a stack that can be read with one more reason to doubt it."""
        return self if self.grid is None or flag in self.flags else replace(self, flags=(flag, *self.flags))


def stacks_of(images: Sequence[SliceImage]) -> list[Stack]:
    """Divide the images of one series into stacks; a refused one says why in ``problem``."""
    parts = _by_plane(images)
    is_each_apart = len(parts) == len(images) >= LEAST_SLICES
    if len(parts) > MOST_PARTS or is_each_apart:
        return [Stack(tuple(images), problem=_why_so_many(images, parts))]
    stacks = [stack for part in parts for stack in _stacks_of_plane(part)]
    if len(stacks) > 1:
        apart = what_differs([stack.slices[0] for stack in stacks])
        stacks = [replace(stack, apart=apart) for stack in stacks]
    if all(stack.problem is None for stack in stacks):
        return stacks
    return [stack.flagged(VolumeFlag.IMAGES_LEFT_OUT) for stack in stacks]


def _by_plane(images: Sequence[SliceImage]) -> list[list[SliceImage]]:
    """Group images that share patient, study, size, orientation, pixel spacing, frame of reference and stack."""
    groups: list[list[SliceImage]] = []
    for image in images:
        for group in groups:
            if share_plane(group[0], image):
                group.append(image)
                break
        else:
            groups.append([image])
            if len(groups) > MOST_PARTS:
                break
    return groups


def _why_so_many(images: Sequence[SliceImage], parts: Sequence[object]) -> str:
    """Say by what images fall into too many parts: programs that write, or take names away, may give each its own."""
    mixed = what_differs(images)
    told = ", ".join(mixed[:MOST_MIXED]) if len(mixed) > MOST_MIXED else " and ".join(mixed)
    counted = len(parts) if len(parts) <= MOST_PARTS else f"more than {MOST_PARTS}"
    return (
        f"it mixes too many {told} ({counted} parts of {len(images)} images); export it again so that its files "
        "share them"
    )


def _grouped(images: Sequence[SliceImage], key: Callable[[SliceImage], str]) -> list[list[SliceImage]]:
    groups: dict[str, list[SliceImage]] = defaultdict(list)
    for image in images:
        groups[key(image)].append(image)
    return list(groups.values())


def _stacks_of_plane(images: list[SliceImage]) -> list[Stack]:
    """Build the stack of images that share one orientation, dividing interleaved acquisitions."""
    try:
        row_step, column_step = _steps(images[0])
        origins = np.array([image.origin_mm for image in images])
        if float(np.abs(origins).max()) > FARTHEST_POINT_MM:
            raise InputError(f"a slice lies more than {FARTHEST_POINT_MM / 1000.0:g} m from the origin")
    except InputError as error:
        return [Stack(tuple(images), problem=str(error))]
    normal = np.cross(column_step, row_step)
    normal /= np.linalg.norm(normal)
    kept, positions, dropped = without_copies(images, origins @ normal)
    keys = dict(PASSES)
    if any(image.tube_voltage_kv is None for image in kept):
        del keys[TUBE_VOLTAGES]
    for name, key in keys.items():
        parts = _grouped(kept, key)
        if 1 < len(parts) <= MOST_PARTS and _interleave(parts, normal):
            if name in OF_A_SLICE and _are_one_scan(parts, normal):
                continue
            return [stack for part in parts for stack in _stacks_of_plane(part)]
    stack = _one_stack(kept, positions, row_step, column_step)
    return [stack.flagged(VolumeFlag.DUPLICATES_DROPPED) if dropped else stack]


def _steps(image: SliceImage) -> tuple[FloatArray, FloatArray]:
    """Return the steps (3,) from row to row and from column to column, in mm."""
    if not _are_perpendicular(image.orientation):
        raise InputError("its orientation is not two perpendicular unit vectors")
    along_row, along_column = np.array(image.orientation[:3]), np.array(image.orientation[3:])
    low, high = PIXEL_SIZE_RANGE_MM
    if not all(low <= value <= high for value in image.spacing_mm):
        raise InputError(
            f"its pixel spacing {list(image.spacing_mm)} is not between {low:g} and {high:g} mm; export it again"
        )
    row_spacing, column_spacing = image.spacing_mm
    return unit(along_column) * row_spacing, unit(along_row) * column_spacing


def _are_perpendicular(orientation: Vector) -> bool:
    """Whether an orientation (6,) is two unit vectors at right angles."""
    if max(map(abs, orientation)) > 1.0 + PERPENDICULAR_TOLERANCE:  # products of what is larger may overflow
        return False
    one, other = np.array(orientation[:3]), np.array(orientation[3:])
    off = [abs(float(np.linalg.norm(way)) - 1.0) for way in (one, other)]
    return max(*off, abs(float(one @ other))) <= PERPENDICULAR_TOLERANCE


def _along_mm(images: Sequence[SliceImage], normal: FloatArray) -> FloatArray:
    """Return where (K,) the images lie along the normal, in ascending order."""
    return np.sort(np.array([image.origin_mm for image in images]) @ normal)


def _interleave(parts: list[list[SliceImage]], normal: FloatArray) -> bool:
    """Whether the parts' slices lie among each other, so that they are scans of the same place."""
    along = [_along_mm(part, normal) for part in parts]
    ranges = sorted((float(part[0]), float(part[-1])) for part in along)
    ends = np.maximum.accumulate([high for _, high in ranges])
    return any(low < end + SAME_PLACE_TOLERANCE_MM for (low, _), end in zip(ranges[1:], ends[:-1], strict=True))


def _are_one_scan(parts: list[list[SliceImage]], normal: FloatArray) -> bool:
    """Whether parts that lie among each other fill their gaps: evenly spaced together, and not each by itself."""

    def is_whole(images: Sequence[SliceImage]) -> bool:
        gaps = np.diff(_along_mm(images, normal))
        return len(images) >= LEAST_SLICES and bool(np.ptp(gaps) < UNEVEN_SHARE * np.median(gaps))

    return is_whole([image for part in parts for image in part]) and not all(map(is_whole, parts))


def _one_stack(
    images: list[SliceImage], along: FloatArray, row_step: FloatArray, column_step: FloatArray
) -> Stack:
    slices = tuple(images)
    if len(slices) < LEAST_SLICES:
        counted = "one slice only" if len(slices) == 1 else f"{len(slices)} slices only"
        return Stack(slices, problem=f"it has {counted}; a volume needs {LEAST_SLICES} or more")
    gaps = np.diff(along)
    nearest = int(np.argmin(gaps))
    if gaps[nearest] <= SAME_PLACE_TOLERANCE_MM:
        pair = f"{slices[nearest].name} and {slices[nearest + 1].name}"
        return Stack(
            slices,
            problem=f"different images lie at the same place ({pair}), and not one of {', '.join(PASSES)} tells them "
            "apart; put the files of each scan into a folder of its own",
        )
    if np.median(gaps) > LARGEST_GAP_MM:
        return Stack(
            slices,
            problem=f"its images lie {np.median(gaps):.0f} mm apart: localizers or single cuts, not a volume",
        )
    thickness = {image.thickness_mm for image in slices}
    written_mm = np.array([image.origin_mm for image in slices])
    even_mm = None if np.ptp(gaps) < UNIFORM_SPACING_TOLERANCE_MM else evened(written_mm)
    grid = SliceGrid(
        origins_mm=written_mm if even_mm is None else even_mm,
        row_step_mm=row_step,
        column_step_mm=column_step,
        thickness_mm=thickness.pop() if len(thickness) == 1 else None,
    )
    stack = Stack(slices, grid, tuple(_flags(slices, grid)))
    return stack if even_mm is None else stack.flagged(VolumeFlag.ROUNDED)


def _flags(slices: tuple[SliceImage, ...], grid: SliceGrid) -> list[VolumeFlag]:
    gaps, filled = grid.spacings_mm, _filled_mm(slices)
    tilt_tags = {tag for image in slices if (tag := image.instance.tilt_tag_deg) is not None}
    makings = {(image.image_type, image.technique, image.instance.description) for image in slices}
    made = [flag for making in sorted(makings) for flag in flags_of(*making)]
    doubts = {
        VolumeFlag.LOSSY: any(image.instance.is_lossy for image in slices) or tells_loss(slices[0]),
        VolumeFlag.UNEVEN_SPACING: not grid.is_evenly_spaced,
        VolumeFlag.CUT_SPACING: is_spacing_cut(slices[0]),
        VolumeFlag.MISSING_SLICE: _lacks_slice(grid, filled),
        VolumeFlag.SAME_INSTANCE: _share_uid(slices),
        VolumeFlag.OVERLAPPING: bool((filled > (1.0 + THICKNESS_TOLERANCE) * gaps).any()),
        VolumeFlag.TILT_CONTRADICTS: any(abs(abs(tag) - grid.tilt_deg) > TILT_TOLERANCE_DEG for tag in tilt_tags),
        VolumeFlag.SHEARED: not tilt_tags and grid.is_sheared,
        VolumeFlag.SHIFTED_SIDEWAYS: _sideways_mm(grid) > SIDEWAYS_TOLERANCE_MM,
        VolumeFlag.MIXED_VOLTAGE: len({*map(PASSES[TUBE_VOLTAGES], slices)} - {""}) > 1,
        VolumeFlag.OUT_OF_ORDER: _run_back_s(slices) > OUT_OF_ORDER_S,
        **dict.fromkeys(made, True),
        VolumeFlag.NO_FRAME_OF_REFERENCE: slices[0].instance.frame_of_reference_uid is None,
    }
    return [flag for flag, holds in doubts.items() if holds]


def _share_uid(slices: tuple[SliceImage, ...]) -> bool:
    """Whether two files say that they are one instance; one file may hold many slices."""
    files = {image.instance.blob.name: image.instance.sop_uid for image in slices}
    uids = [uid for uid in files.values() if uid]
    return len(set(uids)) < len(uids)


def _filled_mm(slices: tuple[SliceImage, ...]) -> FloatArray:
    """How far apart (K - 1,) neighbours lie that touch, by their thickness tags; 0 where these say nothing."""
    thickness = np.array([image.thickness_mm or 0.0 for image in slices])
    filled: FloatArray = (thickness[1:] + thickness[:-1]) / 2.0
    return filled


def _lacks_slice(grid: SliceGrid, filled: FloatArray) -> bool:
    """Whether a gap is a whole multiple of the usual one, but not where slices are as much thicker (`_filled_mm`)."""
    multiples = grid.spacings_mm / grid.typical_gap_mm
    whole = np.round(multiples)
    missing = (whole >= 2) & (np.abs(multiples - whole) <= MULTIPLE_TOLERANCE * whole)
    return bool((missing & (_times_usual(grid.spacings_mm, filled) >= 2.0 - 2.0 * MULTIPLE_TOLERANCE)).any())


def _times_usual(gaps: FloatArray, filled: FloatArray) -> FloatArray:
    """Gaps (K - 1,) over what their two slices fill, in terms of what is usual of the scan."""
    shares = gaps / np.where(filled > 0.0, filled, np.median(gaps))
    times: FloatArray = shares / np.median(shares)
    return times


def _run_back_s(slices: tuple[SliceImage, ...]) -> float:
    """Return the longest step of time against the direction in which the slices were taken."""
    times = np.array([image.taken_s for image in slices if image.taken_s is not None])
    steps = np.diff(times)
    forth, back = steps[steps > 0], -steps[steps < 0]
    if not forth.size or not back.size:
        return 0.0
    return float(min(forth.max(), back.max()))


def _sideways_mm(grid: SliceGrid) -> float:
    """Return how far a slice's origin lies at most from the straight line between the first and the last one."""
    positions, first, last = grid.slice_positions_mm, grid.origins_mm[0], grid.origins_mm[-1]
    along = (positions - positions[0]) / (positions[-1] - positions[0])
    return float(np.linalg.norm(grid.origins_mm - (first + along[:, np.newaxis] * (last - first)), axis=1).max())
