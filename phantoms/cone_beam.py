"""A cone-beam scanner: a tube and a flat panel on an arm that turns about the head, once or little more than half."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from tqdm import tqdm

from phantoms.beam import tube_beam
from phantoms.compiled import compiled, parallel_range
from phantoms.cone_rays import Panel, Views, cone_transmission
from phantoms.errors import PhantomError
from phantoms.fdk import Grid, RampFilter, back_project_cone, parker_weights
from phantoms.kernels import kernel
from phantoms.machine import Images, Machine
from phantoms.profiles import Profile
from phantoms.rays import pack
from phantoms.reconstruction import UPSAMPLING, WaterCorrection
from phantoms.scanner import PHOTONS_PER_MM2, SCAN_RADIUS_MM, matter
from phantoms.scene import Scene
from phantoms.solids import FloatArray
from phantoms.stack import SliceStack

Turn = Literal["full", "short"]
FINE_RAYS = 2
"""Rays along each edge of a detector element near a marker."""
ROW_FWHM = 3 - np.sqrt(3)
"""Full width at half maximum of a quadratic spline, in its steps."""
CHUNK = 8
"""Views that are worked on together."""
SCATTER_WIDTH_MM = 50.0
SCATTER_STEP_MM = 4.0
"""Standard deviation of the scatter kernel on the detector, and the grid on which it is computed, at the axis."""
LAG = ((0.030, 0.7), (0.008, 5.0), (0.006, 40.0))
"""What a panel keeps of each frame at lag 1: parts of the signal, and after how many frames they have fallen by e.

About 2.5 % in the first frame after the exposure and 0.2 % in the 40th, as indirect panels with amorphous silicon
have it (Siewerdsen & Jaffray, Med Phys 26:1624, 1999).
"""
DEPTH_STEP = 0.002
DEEPEST = 24.0
"""Spacing and end of the table that turns the depth of attenuation into mm of water."""


@dataclass(frozen=True)
class ConeBeam(Machine):
    """Lengths are those at the axis of rotation: the panel is thought there, scaled down."""

    views: int = 480
    turn: Turn = "full"
    bin_mm: float = 0.4
    """Edge of a detector element."""
    width_mm: float = 300.0
    """Width of the panel; what lies outside its field is truncated."""
    source_mm: float = 650.0
    """Distance from the source to the axis."""
    start_deg: float = 0.0
    """Where the source is first: 0 is along the columns, 90 along the rows."""
    middle_mm: float = 0.0
    """Place of the source's plane along the slices' normal."""
    lag: float = 0.0
    """Image lag of the panel: 1 is usual; see `LAG`."""
    hu_scale: float = 1.0
    """What the 1000 HU between air and water are shown as, in thousands."""
    hu_offset: float = 0.0
    """By how much air, and so everything, is shown above -1000 HU."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(
            ("number of views", self.views, self.views >= 16, "16 or more"),
            ("detector element in mm", self.bin_mm, 0.05 <= self.bin_mm <= 5, "0.05 to 5"),
            ("detector width in mm", self.width_mm, 20 <= self.width_mm <= 600, "20 to 600"),
            ("distance from source to axis in mm", self.source_mm, 400 <= self.source_mm <= 2000, "400 to 2000"),
            ("lag", self.lag, 0 <= self.lag <= 10, "0 to 10"),
            ("HU scale", self.hu_scale, 0.1 <= self.hu_scale <= 10, "0.1 to 10"),
        )

    @property
    def field_radius_mm(self) -> float:
        """Radius of the cylinder that every view sees whole."""
        return float(self.source_mm * np.sin(self.fan_rad))

    @property
    def fan_rad(self) -> float:
        """Half the fan's angle."""
        return float(np.arctan2(self.width_mm / 2, self.source_mm))

    @property
    def angles(self) -> FloatArray:
        """Angles (V,) of the source, from the start of the scan, in radians."""
        if self.turn == "full":
            return 2 * np.pi * np.arange(self.views) / self.views
        return (np.pi + 2 * self.fan_rad) * (np.arange(self.views) + 0.5) / self.views

    def profile(self, stack: SliceStack) -> Profile:
        """Return a Gaussian as wide as the profile of interpolated detector rows: three boxes, one after the other."""
        return Profile("gaussian", ROW_FWHM * self.bin_mm)

    def aimed(self, stack: SliceStack) -> Self:
        """Return the scanner with its source in the middle plane of ``stack``."""
        aimed = super().aimed(stack)
        return replace(aimed, middle_mm=sum(aimed.scanned_mm) / 2)

    def reconstruct(
        self, scene: Scene, stacks: Sequence[SliceStack], *, seed: int = 0, progress: bool = False
    ) -> list[Images]:
        """Return the images of each stack; the scene is measured once."""
        scene.check()
        orbit = _Orbit(self, stacks)
        images = [np.zeros((len(s), s.rows, s.columns), dtype=np.float32) for s in stacks]
        grids = [orbit.grid(stack) for stack in stacks]
        step_mm = (self.bin_mm / UPSAMPLING, self.bin_mm)
        ramp = RampFilter(orbit.columns, self.bin_mm, kernel(self.kernel))
        measured = _Measurement(scene, self, orbit, seed).chunks()
        for part, water_mm in tqdm(measured, "scanning", -(-self.views // CHUNK), disable=not progress):
            filtered = ramp(water_mm)
            for grid, image in zip(grids, images, strict=True):
                angles = orbit.angles[part]
                back_project_cone(filtered, angles, self.source_mm, orbit.first_mm, step_mm, grid, image)
        return [self._in_hu(image, grid) for image, grid in zip(images, grids, strict=True)]

    def _in_hu(self, image: NDArray[np.float32], grid: Grid) -> Images:
        _, rows, columns = image.shape
        x = grid.first_mm[:, 0, np.newaxis, np.newaxis] + np.arange(columns) * grid.pixel_mm
        y = grid.first_mm[:, 1, np.newaxis, np.newaxis] + np.arange(rows)[:, np.newaxis] * grid.pixel_mm
        shown = np.where(np.hypot(x, y) > self.field_radius_mm, 0.0, image)
        return np.asarray(1000 * (self.hu_scale * shown - 1) + self.hu_offset, dtype=np.float32)


class _Orbit:
    """Source and panel around the stacks: the scanner's axes are column, row and normal direction of the slices."""

    def __init__(self, scanner: ConeBeam, stacks: Sequence[SliceStack]) -> None:
        self.scanner, first = scanner, stacks[0]
        self.axes = np.array([first.column_direction, first.row_direction, first.normal])
        axis = first.centers_mm[0]
        self.center_mm = axis + (scanner.middle_mm - axis @ first.normal) * first.normal
        for stack in stacks:
            aside = (stack.centers_mm - self.center_mm) @ self.axes[:2].T
            if np.abs(aside).max() > 1e-6 or not np.allclose(stack.normal, first.normal):
                raise PhantomError(
                    "a cone-beam scanner turns about one axis, square to all slices; "
                    "scan without tilt, and what lies on another axis apart"
                )
        self.turned = scanner.angles
        self.angles = self.turned + np.radians(scanner.start_deg)
        self.columns = 2 * int(scanner.width_mm / 2 / scanner.bin_mm) + 1
        low, high = self._rows(stacks)
        self.rows = high - low + 1
        self.first_mm = (-(self.columns - 1) / 2 * scanner.bin_mm, low * scanner.bin_mm)

    def _rows(self, stacks: Sequence[SliceStack]) -> tuple[int, int]:
        """Return the first and last detector row (0: in the source's plane) that the stacks need."""
        reach, distance = self.scanner.field_radius_mm, self.scanner.source_mm
        heights = np.concatenate([(s.centers_mm - self.center_mm) @ self.axes[2] for s in stacks])
        shadows = np.outer([heights.min(), heights.max()], distance / (distance + np.array([-reach, reach])))
        places = shadows / self.scanner.bin_mm
        return int(np.floor(places.min())) - 2, int(np.ceil(places.max())) + 2

    def grid(self, stack: SliceStack) -> Grid:
        return Grid((stack.origins_mm - self.center_mm) @ self.axes.T, stack.pixel_mm)

    def views(self) -> Views:
        """Return source and panel of every view in LPS mm, as the scene sees them."""
        cosine, sine = np.cos(self.angles)[:, np.newaxis], np.sin(self.angles)[:, np.newaxis]
        towards = cosine * self.axes[0] + sine * self.axes[1]
        across = cosine * self.axes[1] - sine * self.axes[0]
        middles = np.tile(self.center_mm, (len(self.angles), 1))
        up = np.tile(self.axes[2], (len(self.angles), 1))
        still = Views(middles + self.scanner.source_mm * towards, middles, across, up)
        return self.scanner.motion.seen(still, np.linspace(0, 1, len(self.angles)))

    def weights(self) -> NDArray[np.float32]:
        """Return what each ray (V, U) counts for, but for its height: redundancy, and the step between views."""
        u = self.first_mm[0] + np.arange(self.columns) * self.scanner.bin_mm
        fan = np.arctan2(u, self.scanner.source_mm)
        if self.scanner.turn == "full":
            shares, span = np.full((len(self.angles), self.columns), 0.5), 2 * np.pi
        else:
            shares, span = parker_weights(self.turned, fan, self.scanner.fan_rad), np.pi + 2 * self.scanner.fan_rad
        return (shares * span / len(self.angles)).astype(np.float32)


class _Chunk(NamedTuple):
    part: slice
    water_mm: NDArray[np.float32]


class _Measurement:
    """Measures views in their order: quanta, scatter, noise, lag, and the logarithm in mm of water."""

    def __init__(self, scene: Scene, scanner: ConeBeam, orbit: _Orbit, seed: int) -> None:
        self._scanner, self._orbit, self._seed = scanner, orbit, seed
        beam = tube_beam(scanner.kilovolts)
        self._solids = pack([part.solid for part in scene.parts])
        self._matter = matter(scene, beam)
        self._table = WaterCorrection(beam)(np.arange(0, DEEPEST, DEPTH_STEP))
        self._kept: NDArray[np.float32] | None = None

    def chunks(self) -> Iterator[_Chunk]:
        """Yield the views (v, rows, U) in mm of water, weighed for the reconstruction, a few at a time."""
        scanner, orbit = self._scanner, self._orbit
        views, weights = orbit.views(), orbit.weights()
        panel = Panel(scanner.bin_mm, scanner.bin_mm, *orbit.first_mm, FINE_RAYS, SCAN_RADIUS_MM)
        for start in range(0, scanner.views, CHUNK):
            part = slice(start, min(start + CHUNK, scanner.views))
            signal = np.empty((part.stop - start, orbit.rows, orbit.columns), dtype=np.float32)
            some = Views(views.sources[part], views.middles[part], views.across[part], views.up[part])
            cone_transmission(self._solids, self._matter, panel, some, signal)
            for view, number in zip(signal, range(start, part.stop), strict=True):
                self._as_read(view, number)
            weigh(signal, self._table, weights[part], orbit.first_mm, scanner.bin_mm, scanner.source_mm)
            yield _Chunk(part, signal)

    def _as_read(self, view: NDArray[np.float32], number: int) -> None:
        """Turn what arrives (rows, U) into what the panel reads."""
        scanner = self._scanner
        if scanner.scatter:
            view += scattered(view, scanner.scatter, scanner.bin_mm)
        quanta = PHOTONS_PER_MM2 * scanner.dose * scanner.bin_mm**2 * 720 / scanner.views
        scanner.as_read(view, quanta, self._seed, number)
        if scanner.lag:
            self._lagging(view)

    def _lagging(self, view: NDArray[np.float32]) -> None:
        """Add what is left of earlier frames and keep a part of this one; the first is taken to have lasted."""
        parts = np.array([part for part, _ in LAG], dtype=np.float32) * np.float32(self._scanner.lag)
        decays = np.exp(-1 / np.array([frames for _, frames in LAG], dtype=np.float32))
        if self._kept is None:
            self._kept = np.tile(view, (len(LAG), 1, 1))
        read = (1 - parts.sum()) * view
        for kept, part, decay in zip(self._kept, parts, decays, strict=True):
            kept *= decay
            kept += (1 - decay) * view
            read += part * kept
        view[:] = read


def scattered(signal: NDArray[np.float32], strength: float, bin_mm: float) -> NDArray[np.float32]:
    """Return scatter as a broad blur of ``I log(1/I)`` over the panel (Ohnesorge et al., Eur Radiol 9:563, 1999)."""
    step = max(1, round(SCATTER_STEP_MM / bin_mm))
    coarse = signal[::step, ::step].astype(np.float64)
    source = -coarse * np.log(np.maximum(coarse, 1e-12))
    blurred = ndimage.gaussian_filter(source, SCATTER_WIDTH_MM / (step * bin_mm), mode="nearest")
    rows, columns = (np.arange(size) / step for size in signal.shape)
    places = np.meshgrid(rows, columns, indexing="ij")
    return np.asarray(strength * ndimage.map_coordinates(blurred, places, order=1, mode="nearest"), np.float32)


@compiled(parallel=True)
def weigh(
    signal: NDArray[np.float32],
    table: FloatArray,
    weights: NDArray[np.float32],
    first_mm: tuple[float, float],
    bin_mm: float,
    source_mm: float,
) -> None:
    """Turn readings (V, rows, U) into mm of water times the cosine to the central ray and ``weights`` (V, U).

    ``table`` holds the mm of water at multiples of `DEPTH_STEP`; below zero it is continued linearly.
    """
    views, rows, columns = signal.shape
    for job in parallel_range(views * rows):
        view, row = job // rows, job % rows
        v = first_mm[1] + row * bin_mm
        for column in range(columns):
            u = first_mm[0] + column * bin_mm
            depth = -np.log(max(signal[view, row, column], np.float32(1e-10))) / DEPTH_STEP
            place = min(max(depth, 0.0), len(table) - 1.001)
            n = int(place)
            water = table[n] + (depth - n) * (table[n + 1] - table[n])
            cosine = source_mm / np.sqrt(source_mm * source_mm + u * u + v * v)
            signal[view, row, column] = water * cosine * weights[view, column]
