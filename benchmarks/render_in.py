"""Balls put into real scans: found, error and honesty of what is stated, series by series.

    python -m benchmarks.render_in FOLDER [--balls N] [--diameter MM] [--seed N] [--profile box|bell]

Every CT series below FOLDER gets balls of plastic in the air beside what it shows, at random places between its voxels,
as sharp as the series' own edges and as noisy as its own tissue; what of them is lost is listed with the localizer's
reason. The code that draws them shares nothing with the localizer: fine rays through the ball along the slices' normal,
what each slice sees of them in closed form, a Gaussian blur, and the scan's own voxel places.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

from benchmarks.scores import CHI2_95, FOUND_WITHIN_MM
from benchmarks.seen_blur import BODY_HU, edge_blur_mm, tissue_noise_hu
from phantoms.fast import textured_noise
from ronnaplan.ct import CTVolume, read_ct
from ronnaplan.ct.summary import summarize
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import Fiducials, localize
from ronnaplan.report.tables import align

BALL_HU = 120.0
"""Acrylic."""

AIR_HU = -800.0
"""What is darker is air, of which the balls replace a part."""

CLEAR_MM = 4.0
"""Beyond a ball's surface its blur needs so much air."""

NEAR_MM = 40.0
"""A ball's middle is within its radius and this from what is scanned."""

RAYS_PER_MM = 20.0
"""Fine rays; four times as many change a center by less than a micrometre."""

AT_ONCE = 12
TOUCHING = 1.02
"""Slices touch up to this many thicknesses apart: places are rounded."""

HEADING = ("series", "blur mm", "noise HU", "slices", "found", "mean um", "worst um", "nees", "in 95 %", "false")


@dataclass
class Score:
    """What the balls of one kind add up to."""

    placed: int = 0
    errors_mm: list[float] = field(default_factory=list)
    normalized: list[float] = field(default_factory=list)

    def add(self, place: FloatArray, found: Fiducials) -> str | None:
        """Count one ball; say why it was missed, if it was."""
        self.placed += 1
        own = [one for one in found.fiducials if np.linalg.norm(one.center_mm - place) < FOUND_WITHIN_MM]
        if own:
            error = own[0].center_mm - place
            self.errors_mm.append(float(np.linalg.norm(error)))
            self.normalized.append(float(error @ np.linalg.solve(own[0].covariance_mm2, error)))
            return None
        near = [one for one in found.rejected if np.linalg.norm(one.center_mm - place) < found.diameters_mm[0] / 2]
        return f"{near[0].test}: {near[0].reason}" if near else "no candidate"

    def cells(self) -> list[str]:
        """Found, error and honesty."""
        found = f"{len(self.errors_mm)} of {self.placed}"
        if not self.errors_mm:
            return [found, *["-"] * 4]
        squares = np.array(self.normalized)
        return [
            found,
            f"{1e3 * np.mean(self.errors_mm):.1f}",
            f"{1e3 * np.max(self.errors_mm):.1f}",
            f"{squares.mean() / 3:.2f}",
            f"{np.mean(squares <= CHI2_95):.0%}",
        ]


@dataclass(frozen=True)
class Series:
    """A real scan with what is measured of it: blur, noise, and how thick each slice is (K,)."""

    name: str
    volume: CTVolume
    blur_mm: float
    noise_hu: float
    thickness_mm: FloatArray


def measured(name: str, volume: CTVolume) -> Series:
    """Measure a series. Without a tag a slice is taken to be as thick as the narrower of the gaps beside it."""
    gaps = volume.grid.spacings_mm
    beside = np.minimum(np.append(gaps[:1], gaps), np.append(gaps, gaps[-1:]))
    usual = np.where(beside < 0.5 * np.median(gaps), np.roll(beside, 1), beside)  # a joint of two stacks
    thickness = np.full(len(usual), volume.grid.thickness_mm) if volume.grid.thickness_mm else usual
    return Series(name, volume, edge_blur_mm(volume), tissue_noise_hu(volume), thickness)


def air_places(series: Series, diameter_mm: float, count: int, generator: np.random.Generator) -> list[FloatArray]:
    """Draw places (3,) whose ball is whole in the scan, in air, near what is scanned, clear of the other balls."""
    volume, grid = series.volume, series.volume.grid
    body = volume.voxels_hu > BODY_HU
    other = volume.voxels_hu > AIR_HU
    if volume.padding_hu is not None:
        other |= volume.voxels_hu == volume.padding_hu
    other[:, [0, -1]] = other[:, :, [0, -1]] = True  # beyond the picture's edge nothing is measured
    steps = (grid.typical_gap_mm, grid.row_spacing_mm, grid.column_spacing_mm)
    to_body = ndimage.distance_transform_edt(~_largest(body), sampling=steps)
    clear = ndimage.distance_transform_edt(~other, sampling=steps)
    radius_mm = diameter_mm / 2
    free = np.argwhere((clear > radius_mm + CLEAR_MM) & (to_body < radius_mm + NEAR_MM))
    positions = grid.slice_positions_mm
    places: list[FloatArray] = []
    for index in generator.permutation(free)[:20000]:
        if len(places) == count:
            break
        place = grid.positions_mm(index + generator.uniform(-0.5, 0.5, 3))
        height = float(place @ grid.normal)
        ends = positions[0] - series.thickness_mm[0] / 2, positions[-1] + series.thickness_mm[-1] / 2
        whole = height - radius_mm > ends[0] and height + radius_mm < ends[1]
        apart = min((float(np.linalg.norm(place - one)) for one in places), default=np.inf)
        if whole and apart > 2 * diameter_mm:
            places.append(place)
    return places


def _largest(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    labels, count = ndimage.label(mask)
    if count < 2:
        return mask
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    largest: NDArray[np.bool_] = labels == int(np.argmax(sizes))
    return largest


def with_balls(
    series: Series, places: list[FloatArray], diameter_mm: float, profile: str, generator: np.random.Generator
) -> CTVolume:
    """Return the scan with a ball at each place."""
    voxels = series.volume.voxels_hu.astype(np.float64)
    for place in places:
        for k, rows, columns, share in _shares(series, place, diameter_mm / 2, profile):
            window = voxels[k, rows, columns]
            noise = series.noise_hu * textured_noise(generator, share.shape, series.volume.grid.row_spacing_mm)
            window += share * (BALL_HU + noise - window)
    lowest, highest = float(series.volume.voxels_hu.min()), max(3071.0, float(series.volume.voxels_hu.max()))
    return replace(series.volume, voxels_hu=np.round(np.clip(voxels, lowest, highest)).astype(np.int16))


def _shares(
    series: Series, place: FloatArray, radius_mm: float, profile: str
) -> Iterator[tuple[int, slice, slice, FloatArray]]:
    """Yield, for each slice that sees the ball, its number, its window of rows and columns, and each pixel's share."""
    grid = series.volume.grid
    steps_mm = np.array([grid.row_spacing_mm, grid.column_spacing_mm])
    reach = np.ceil((radius_mm + 5 * series.blur_mm) / steps_mm).astype(int)
    fine = int(np.ceil(RAYS_PER_MM * steps_mm.max())) // 2 * 2 + 1  # one ray goes through each pixel's middle
    for k, height in enumerate(grid.slice_positions_mm):
        weights, edges = slice_layers(profile, float(series.thickness_mm[k]))
        middle = float(place @ grid.normal) - height
        if abs(middle) > radius_mm + edges[-1]:
            continue
        from_origin = place - grid.origins_mm[k]
        at = np.array([from_origin @ grid.row_step_mm, from_origin @ grid.column_step_mm]) / steps_mm**2
        first = np.maximum(np.rint(at).astype(int) - reach, 0)
        last = np.minimum(np.rint(at).astype(int) + reach + 1, series.volume.voxels_hu.shape[1:])
        rows, columns = (
            (first[n] - at[n] + (np.arange((last[n] - first[n]) * fine) - fine // 2) / fine) * steps_mm[n]
            for n in (0, 1)
        )
        half_chord = np.sqrt(np.maximum(radius_mm**2 - rows[:, np.newaxis] ** 2 - columns**2, 0.0))
        inside = [
            np.maximum(np.minimum(middle + half_chord, above) - np.maximum(middle - half_chord, below), 0.0)
            for below, above in pairwise(edges)
        ]
        seen = np.einsum("l,lrc->rc", weights / np.diff(edges), np.array(inside))
        blurred = ndimage.gaussian_filter(seen, series.blur_mm / steps_mm * fine, truncate=5.0, mode="nearest")
        share = blurred[fine // 2 :: fine, fine // 2 :: fine]
        yield k, slice(first[0], last[0]), slice(first[1], last[1]), share


def slice_layers(profile: str, thickness_mm: float) -> tuple[FloatArray, FloatArray]:
    """What layers of a slice weigh (L,), and their edges (L + 1,): a box, or a bell as wide at half its height."""
    if profile == "box":
        return np.ones(1), np.array([-0.5, 0.5]) * thickness_mm
    edges = np.linspace(-4, 4, 65) * thickness_mm / np.sqrt(8 * np.log(2))
    weights = np.diff(special.ndtr(np.linspace(-4, 4, 65)))
    return weights / weights.sum(), edges


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--balls", type=int, default=40, help="balls in each series")
    parser.add_argument("--diameter", type=float, default=11.5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--profile", choices=("box", "bell"), default="box")
    arguments = parser.parse_args()
    rows = [list(HEADING)]
    for summary in summarize(arguments.folder)[0]:
        if summary.is_usable:
            name = f"{summary.description or summary.kernel or 'CT'} ({summary.images} slices)"
            rows += _rows(measured(name, read_ct(arguments.folder, summary.series)), arguments)
    print(align(rows))
    return 0


def _rows(series: Series, arguments: argparse.Namespace) -> list[list[str]]:
    """Put the balls in, at most `AT_ONCE` at a time, and score them."""
    generator = np.random.default_rng(arguments.seed)
    scores = {True: Score(), False: Score()}
    false, left = 0, arguments.balls
    while left > 0:
        places = air_places(series, arguments.diameter, min(left, AT_ONCE), generator)
        if not places:
            print(f"{series.name}: no air for a ball of {arguments.diameter:g} mm", file=sys.stderr)
            break
        left -= len(places)
        found = localize(
            with_balls(series, places, arguments.diameter, arguments.profile, generator),
            diameter_mm=arguments.diameter,
        )
        known = np.array(places)
        false += sum(np.linalg.norm(known - each, axis=1).min() > FOUND_WITHIN_MM for each in found.centers)
        for place in places:
            score = scores[touches(series, place, arguments.diameter / 2)]
            reason = score.add(place, found)
            if reason:
                print(f"{series.name}: missed at {np.round(place, 1)}: {reason}", file=sys.stderr)
    measures = [series.name, f"{series.blur_mm:.2f}", f"{series.noise_hu:.1f}"]
    return [
        [*measures, "touch" if touching else "gaps", *score.cells(), str(false)]
        for touching, score in scores.items()
        if score.placed
    ]


def touches(series: Series, place: FloatArray, radius_mm: float) -> bool:
    """Whether the slices that see the ball lie no farther apart than they are thick."""
    heights = series.volume.grid.slice_positions_mm - float(place @ series.volume.grid.normal)
    near = np.abs(heights) < radius_mm + series.thickness_mm
    gaps = np.diff(heights[near])
    return bool(
        np.all(gaps <= TOUCHING * np.maximum(series.thickness_mm[near][1:], series.thickness_mm[near][:-1]))
    )


if __name__ == "__main__":
    sys.exit(main())
