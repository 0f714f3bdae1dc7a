"""A quick look at nearest voxels: it spares most candidates the fit, and tells what of a ball the scan holds."""

from __future__ import annotations

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.detect import MIN_CONTRAST_HU
from ronnaplan.localization.guess import margin_mm
from ronnaplan.localization.neighbourhood import cell_directions

AT_ONCE = 1000
"""So many places are looked at together; a scan with small markers has thousands."""

BACKGROUND_SHARE = 0.3
"""The surroundings' level is what this share of the directions reach at most: something touches most markers."""


def surface_shares(
    volume: CTVolume, centers_mm: FloatArray, diameter_mm: float, build: Build, thickness_mm: float
) -> FloatArray:
    """Share (N,) of directions in which the image falls from a ball's level to its surroundings' at its surface.

    A fit at such a place of ``centers_mm`` (N, 3) cannot cover more of the surface.
    """
    chunks = [centers_mm[n : n + AT_ONCE] for n in range(0, len(centers_mm), AT_ONCE)]
    shares = [_shares(volume, chunk, diameter_mm, build, thickness_mm) for chunk in chunks]
    return np.concatenate(shares) if shares else np.empty(0)


def unseen_share(volume: CTVolume, center_mm: FloatArray, radius_mm: float) -> float:
    """Share of the ball's directions whose surface lies outside the scan, or where its voxels are padding."""
    return float(np.mean(np.isnan(_samples(volume, center_mm + radius_mm * cell_directions()))))


def _shares(
    volume: CTVolume, centers_mm: FloatArray, diameter_mm: float, build: Build, thickness_mm: float
) -> FloatArray:
    radius_mm = diameter_mm / 2.0
    directions = cell_directions()
    axial = np.abs(directions @ volume.grid.normal)[:, np.newaxis]
    margin = margin_mm(0.0) + (margin_mm(thickness_mm) - margin_mm(0.0)) * axial
    at = centers_mm[:, np.newaxis]
    depth_mm = build.wall_mm / 2.0 if build.wall_mm else radius_mm / 2.0
    inner = _samples(volume, at + (radius_mm - depth_mm) * directions)
    outer = _samples(volume, at + (radius_mm + max(build.layer_mm, 0.0) + 0.7 * margin) * directions)
    known = np.isfinite(inner).any(axis=1) & np.isfinite(outer).any(axis=1)
    shares = np.zeros(len(centers_mm))
    high = np.nanmedian(inner[known], axis=1)
    low = np.nanquantile(outer[known], BACKGROUND_SHARE, axis=1)
    middle = ((high + low) / 2.0)[:, np.newaxis]
    falls = np.mean((inner[known] > middle) & (outer[known] < middle), axis=1)
    shares[known] = np.where(high - low < MIN_CONTRAST_HU, 0.0, falls)
    return shares


def _samples(volume: CTVolume, places_mm: FloatArray) -> FloatArray:
    """Nearest voxel's value at each place (..., 3); NaN outside the scan and in its padding."""
    indices = np.rint(volume.grid.indices(places_mm.reshape(-1, 3))).astype(np.intp)
    inside = np.all((indices >= 0) & (indices < volume.voxels_hu.shape), axis=1)
    values = np.full(len(indices), np.nan)
    found = volume.voxels_hu[tuple(indices[inside].T)].astype(np.float64)
    if volume.padding_hu is not None:
        found[found == volume.padding_hu] = np.nan
    values[inside] = found
    return values.reshape(places_mm.shape[:-1])
