"""Where the slices of a scan lie: any orientation, tilt and spacing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phantoms.errors import PhantomError
from phantoms.solids import FloatArray, Vector

TABLE = np.array([0.0, 0.0, 1.0])
"""Direction of table travel before ``orientation`` is applied: feet to head."""

MOST_SLICES = 20_000
"""More slices than any scan has: a slip in the spacing."""


@dataclass(frozen=True)
class SliceStack:
    """Parallel slices in LPS mm, in acquisition order.

    ``centers_mm`` (K, 3) is where the axis of rotation meets each slice; ``column_direction`` and
    ``row_direction`` (3,) are the unit vectors of increasing column and row index.
    """

    centers_mm: FloatArray
    column_direction: FloatArray
    row_direction: FloatArray
    pixel_mm: float
    rows: int
    columns: int
    thickness_mm: float
    tilt_deg: float = 0.0
    aside_mm: tuple[float, float] = (0.0, 0.0)
    """Place of the images' centers beside ``centers_mm``, along the columns' and the rows' direction."""
    field_radius_mm: float = float("inf")
    """Distance from the axis of rotation up to which the scanner sees."""

    def __len__(self) -> int:
        return len(self.centers_mm)

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,) of the slices: column direction x row direction."""
        return np.cross(self.column_direction, self.row_direction)

    @property
    def origins_mm(self) -> FloatArray:
        """Centers (K, 3) of the voxels (row 0, column 0)."""
        x = self.aside_mm[0] - (self.columns - 1) / 2 * self.pixel_mm
        y = self.aside_mm[1] - (self.rows - 1) / 2 * self.pixel_mm
        return self.centers_mm + x * self.column_direction + y * self.row_direction

    @property
    def positions_mm(self) -> FloatArray:
        """Places (K,) of the slices along ``normal``."""
        return self.centers_mm @ self.normal

    @property
    def travel(self) -> FloatArray:
        """Unit vector (3,) along which the table moved from slice to slice; the normal when there is one slice."""
        way = self.centers_mm[-1] - self.centers_mm[0]
        length = float(np.linalg.norm(way))
        return way / length if length > 0 else self.normal

    def wider(self, pixels: int) -> SliceStack:
        """Return the same slices with so many more pixels on every side."""
        return replace(self, rows=self.rows + 2 * pixels, columns=self.columns + 2 * pixels)

    def changed(
        self,
        *,
        start_mm: float | None = None,
        stop_mm: float | None = None,
        spacing_mm: float | None = None,
        thickness_mm: float | None = None,
        matrix: int | None = None,
        field_of_view_mm: float | None = None,
        tilt_deg: float | None = None,
    ) -> SliceStack:
        """Return an evenly spaced axial stack like this one but for what is given."""
        heights = np.sort(self.centers_mm @ TABLE)
        gap = float(np.diff(heights).mean()) if len(heights) > 1 else self.thickness_mm
        thickness = self.thickness_mm if spacing_mm is None else spacing_mm
        return axial_stack(
            start_mm=float(heights[0]) if start_mm is None else start_mm,
            stop_mm=float(heights[-1]) if stop_mm is None else stop_mm,
            spacing_mm=gap if spacing_mm is None else spacing_mm,
            thickness_mm=thickness if thickness_mm is None else thickness_mm,
            matrix=self.rows if matrix is None else matrix,
            field_of_view_mm=self.rows * self.pixel_mm if field_of_view_mm is None else field_of_view_mm,
            center_mm=self.centers_mm[0] * (1 - TABLE),
            tilt_deg=self.tilt_deg if tilt_deg is None else tilt_deg,
        )

    def around(self, center_mm: Vector, reach_mm: float, *, crop: bool = False) -> SliceStack:
        """Return only the slices within ``reach_mm`` of a place; with ``crop``, only such pixels, too."""
        place = np.asarray(center_mm, dtype=np.float64)
        distance = np.abs(self.positions_mm - place @ self.normal)
        if distance.min() > reach_mm:
            raise PhantomError(
                f"no slice lies within {reach_mm:g} mm of {place.tolist()}; choose a place in the scan"
            )
        kept = replace(self, centers_mm=self.centers_mm[distance <= reach_mm])
        return kept._cropped(place - self.origins_mm[np.argmin(distance)], reach_mm) if crop else kept

    def _cropped(self, offset_mm: FloatArray, reach_mm: float) -> SliceStack:
        """Return the pixels about a place that lies ``offset_mm`` from the first pixel of its slice."""
        sizes, aside = [], []
        for direction, whole, old in (
            (self.column_direction, self.columns, self.aside_mm[0]),
            (self.row_direction, self.rows, self.aside_mm[1]),
        ):
            middle = float(offset_mm @ direction) / self.pixel_mm
            first = max(0, int(np.floor(middle - reach_mm / self.pixel_mm)))
            last = min(whole - 1, int(np.ceil(middle + reach_mm / self.pixel_mm)))
            if last < first:
                raise PhantomError("the place to crop to lies outside the field of view; choose one inside it")
            sizes.append(last - first + 1)
            aside.append(old + ((first + last) / 2 - (whole - 1) / 2) * self.pixel_mm)
        return replace(self, columns=sizes[0], rows=sizes[1], aside_mm=(aside[0], aside[1]))

    def holds_whole(self, center_mm: FloatArray, diameter_mm: float) -> bool:
        """Whether a ball lies wholly within the scanned slab and every slice's field of view near it."""
        radius = diameter_mm / 2
        position = float(center_mm @ self.normal)
        lowest, highest = self.positions_mm.min(), self.positions_mm.max()
        half = self.thickness_mm / 2
        if position - radius < lowest - half or position + radius > highest + half:
            return False
        near = np.abs(self.positions_mm - position) <= radius + half
        offsets = center_mm - self.centers_mm[near]
        x = np.abs(offsets @ self.column_direction - self.aside_mm[0])
        y = np.abs(offsets @ self.row_direction - self.aside_mm[1])
        if np.linalg.norm(offsets - (offsets @ self.normal)[:, np.newaxis] * self.normal, axis=1).max() > (
            self.field_radius_mm - radius
        ):
            return False
        field = self.pixel_mm / 2
        return bool((x.max() + radius <= self.columns * field) and (y.max() + radius <= self.rows * field))


def axial_stack(
    *,
    start_mm: float,
    stop_mm: float,
    spacing_mm: float = 1.0,
    thickness_mm: float | None = None,
    matrix: int = 512,
    field_of_view_mm: float = 250.0,
    center_mm: Vector = (0.0, 0.0, 0.0),
    tilt_deg: float = 0.0,
    orientation: FloatArray | None = None,
    positions_mm: Vector | None = None,
) -> SliceStack:
    """Return slices from ``start_mm`` to ``stop_mm`` along the table, through the field of view's center.

    ``tilt_deg`` turns the gantry about the patient's x axis while the table still travels along z, so the images
    drift as on a real scanner. ``positions_mm`` (K,) replaces the even spacing; ``orientation`` (3, 3) finally
    turns the whole scanner about the origin of the patient's coordinates.
    """
    thickness = spacing_mm if thickness_mm is None else thickness_mm
    _check(spacing_mm, thickness, matrix, field_of_view_mm, tilt_deg)
    if positions_mm is None:
        if not np.isfinite([start_mm, stop_mm]).all():
            raise PhantomError(f"the slices go from {start_mm} to {stop_mm} mm; expected two finite places")
        count = np.floor((stop_mm - start_mm) / spacing_mm + 1e-9) + 1  # infinite where a spacing is next to none
        if count > MOST_SLICES:
            raise PhantomError(f"{count:.0f} slices were asked for; expected at most {MOST_SLICES}")
        travel = start_mm + spacing_mm * np.arange(max(int(count), 0))
    else:
        travel = np.asarray(positions_mm, dtype=np.float64)
    if travel.size == 0:
        raise PhantomError(f"no slice lies between {start_mm} and {stop_mm} mm; expected start below stop")
    turn = np.eye(3) if orientation is None else np.asarray(orientation, dtype=np.float64)
    tilt = np.radians(tilt_deg)
    return SliceStack(
        (np.asarray(center_mm, dtype=np.float64) + travel[:, np.newaxis] * TABLE) @ turn.T,
        turn @ np.array([1.0, 0.0, 0.0]),
        turn @ np.array([0.0, np.cos(tilt), -np.sin(tilt)]),
        field_of_view_mm / matrix,
        matrix,
        matrix,
        thickness,
        tilt_deg,
    )


def _check(spacing: float, thickness: float, matrix: int, field: float, tilt: float) -> None:
    for name, value in (("spacing", spacing), ("slice thickness", thickness), ("field of view", field)):
        if not (np.isfinite(value) and value > 0):
            raise PhantomError(f"the {name} is {value} mm; expected a positive length")
    if not 16 <= matrix <= 4096:
        raise PhantomError(f"the matrix is {matrix}; expected 16 to 4096 pixels")
    if not abs(tilt) <= 45:
        raise PhantomError(f"the gantry tilt is {tilt} degrees; expected -45 to 45")
