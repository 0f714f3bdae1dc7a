"""Votes for the centers of balls: edges give them, and where most agree there may be a ball."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.threads import in_parts

VOTE_CELLS_PER_DIAMETER = 6
"""Votes are counted in cells of this share of the diameter, but never smaller than a pixel."""

MIN_VOTE_SHARE = 0.3
"""A candidate has at least this share of the votes of a complete, isolated ball of its size."""

Edges = NDArray[np.float32]
"""Voxels (6, N) of a slab that may lie on a surface: where along u, v, w (mm), and the direction in which the image
rises there."""

Votes = NDArray[np.uint8]
"""Votes (z, y, x) by cells."""

Sums = NDArray[np.uint16]
"""What 3 x 3 x 3 cells gather."""

MOST_VOTES = 255
"""No cell counts more: balls gather up to a hundred in one, and one with so many is a peak whatever else it gets."""


def cell_mm(diameter_mm: float, least_mm: float) -> float:
    """Return how large the cells are in which votes for balls of ``diameter_mm`` are counted."""
    return max(diameter_mm / VOTE_CELLS_PER_DIAMETER, least_mm)


@dataclass(frozen=True)
class Ballot:
    """The votes (z, y, x) for centers of balls of one size.

    They are counted in cells of ``cell_mm``, the first of which lies at the ``corner`` (u, v, w).
    """

    diameter_mm: float
    corner: FloatArray
    cell_mm: float
    votes: Votes

    @classmethod
    def over(cls, low: FloatArray, high: FloatArray, diameter_mm: float, least_mm: float) -> Ballot:
        """Return one without votes over a scan from ``low`` (3,) to ``high``; no cell is smaller than ``least_mm``."""
        edge_mm = cell_mm(diameter_mm, least_mm)
        corner = low - edge_mm
        shape = np.ceil((high - corner) / edge_mm).astype(int) + 2
        return cls(diameter_mm, corner, edge_mm, np.zeros(shape[::-1], dtype=np.uint8))

    def count(self, edges: Sequence[Edges]) -> None:
        """Count the votes of a slab's ``edges``; by one thread, for two would write to the same cells."""
        for some in edges:
            _vote(some, self.diameter_mm / 2.0, self.corner, self.cell_mm, self.votes)

    def counted(self, voxels_per_mm2: float, axes: FloatArray) -> FloatArray:
        """Return the places (N, 3) in LPS mm that are worth a fit, those with most votes first.

        A surface has so many voxels, and ``axes`` (3, 3) are u, v, w in LPS.
        """
        surface_voxels = np.pi * self.diameter_mm**2 * voxels_per_mm2
        centers = _peaks(self.votes, MIN_VOTE_SHARE * surface_voxels)
        places_mm: FloatArray = (self.corner + centers * self.cell_mm) @ axes
        return places_mm


@njit(cache=True)
def marks_for(count: int) -> NDArray[np.bool_]:
    """Return so many marks, and up to seven more, of which none is set: `find_marked` asks eight of them at once."""
    return np.zeros((count + 7) // 8 * 8, dtype=np.bool_)


@njit(cache=True, nogil=True)
def find_marked(marks: NDArray[np.bool_], at: NDArray[np.intp]) -> int:
    """Fill ``at``, as long as the ``marks``, with the numbers of those few that are set; return how many they are."""
    by_eight, count = marks.view(np.uint64), 0
    for some in range(len(by_eight)):
        if by_eight[some] != 0:
            for n in range(8 * some, 8 * some + 8):
                at[count] = n
                count += marks[n]
    return count


@njit(cache=True, nogil=True)
def _vote(edges: Edges, radius: float, corner: FloatArray, cell: float, votes: Votes) -> None:
    """Let each edge vote for what lies one ``radius`` up the image from it."""
    u, v, w, rises_u, rises_v, rises_w = edges[0], edges[1], edges[2], edges[3], edges[4], edges[5]
    per_cell = 1.0 / cell
    for n in range(len(u)):
        x = int((u[n] + radius * rises_u[n] - corner[0]) * per_cell + 0.5)
        y = int((v[n] + radius * rises_v[n] - corner[1]) * per_cell + 0.5)
        z = int((w[n] + radius * rises_w[n] - corner[2]) * per_cell + 0.5)
        if 0 <= z < votes.shape[0] and 0 <= y < votes.shape[1] and 0 <= x < votes.shape[2]:
            votes[z, y, x] += votes[z, y, x] < MOST_VOTES


def _peaks(votes: Votes, least: float) -> FloatArray:
    """Local maxima (N, 3) = (x, y, z), in cells, of the votes gathered over 3 x 3 x 3 cells; the strongest first."""
    parts = in_parts(lambda first, end: _gather_peaks(votes, least, first, end), len(votes))
    places, strength, centers = (np.concatenate(some) for some in zip(*parts, strict=True))
    ordered: FloatArray = centers[np.lexsort((*places.T, -strength))]
    return ordered


@njit(cache=True, nogil=True)
def _gather_peaks(
    votes: Votes, threshold: float, first: int, end: int
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Cells (N, 3) = (z, y, x) whose 3 x 3 x 3 sum is a local maximum, that sum (N,), and its centroid (x, y, z).

    Of the layers ``first`` to ``end``.
    """
    places = []
    strengths = []
    centers = []
    depth, height, width = votes.shape
    least = np.uint16(math.ceil(threshold))
    within = np.empty((3, height, width), dtype=np.uint16)  # of three layers, each at its number modulo 3
    sums, tops = np.empty_like(within), np.empty((3, height), dtype=np.uint16)
    is_high = marks_for(width)
    at = np.empty(len(is_high), dtype=np.intp)
    begin, past = max(first, 1), min(end, depth - 1)
    for ahead in range(begin - 2, past + 2):
        _sum_within(votes, ahead, within)
        if ahead >= begin:
            _sum_layers(votes, ahead - 1, within, sums, tops)
        z = ahead - 2
        for y in range(1, height - 1 if z >= begin else 0):
            if tops[z % 3, y] < least:
                continue
            _mark_high(sums, z, y, least, is_high[:width])
            for x in at[: find_marked(is_high, at)]:
                if _is_peak(sums, z, y, x):
                    total = float(sums[z % 3, y, x])
                    places.append((z, y, x))
                    strengths.append(total)
                    centers.append(_centroid(votes, z, y, x, total))
    count = len(places)
    place_array = np.empty((count, 3), dtype=np.int64)
    center_array = np.empty((count, 3))
    strength_array = np.empty(count)
    for n in range(count):
        strength_array[n] = strengths[n]
        for axis in range(3):
            place_array[n, axis] = places[n][axis]
            center_array[n, axis] = centers[n][axis]
    return place_array, strength_array, center_array


@njit(cache=True, nogil=True)
def _sum_within(votes: Votes, z: int, within: Sums) -> None:
    """Fill the layer of ``within`` with the votes in the 3 x 3 cells of layer ``z`` about each, if there is one."""
    depth, height, width = votes.shape
    across = np.empty(width, dtype=np.uint16)
    for y in range(height):
        across[:] = 0
        for b in range(max(y - 1, 0), min(y + 2, height) if 0 <= z < depth else 0):
            row = votes[z, b]
            for x in range(width):
                across[x] += row[x]
        into = within[z % 3, y]
        into[0], into[width - 1] = across[0] + across[1], across[width - 2] + across[width - 1]
        for x in range(1, width - 1):
            into[x] = across[x - 1] + across[x] + across[x + 1]


@njit(cache=True, nogil=True)
def _sum_layers(votes: Votes, z: int, within: Sums, sums: Sums, tops: Sums) -> None:
    """Fill the layer of ``sums`` with the votes in the 3 x 3 x 3 cells about each cell of layer ``z``.

    ``tops`` gets the largest sum of each row. Of a cell that nobody voted for 0 is told: between two slices' votes it
    would gather most, and nobody be the peak.
    """
    _, height, width = votes.shape
    for y in range(height):
        before, here, behind = within[(z - 1) % 3, y], within[z % 3, y], within[(z + 1) % 3, y]
        into, own, top = sums[z % 3, y], votes[z, y], np.uint16(0)
        for x in range(width):
            into[x] = (before[x] + here[x] + behind[x]) * (own[x] != 0)
            top = max(top, into[x])
        tops[z % 3, y] = top


@njit(cache=True, nogil=True)
def _mark_high(sums: Sums, z: int, y: int, least: np.uint16, is_high: NDArray[np.bool_]) -> None:
    """Mark in ``is_high`` (x,) the inner cells of a row that gather ``least``, and most of the six nearest ones.

    Of equal ones the first. Many at once, before the few that are left are asked one by one.
    """
    last = len(is_high) - 1
    row, left, right = sums[z % 3, y, 1:last], sums[z % 3, y, : last - 1], sums[z % 3, y, 2:]
    above, below = sums[z % 3, y - 1, 1:last], sums[z % 3, y + 1, 1:last]
    before, behind = sums[(z - 1) % 3, y, 1:last], sums[(z + 1) % 3, y, 1:last]
    inner = is_high[1:last]
    for x in range(len(inner)):
        is_higher = row[x] > max(left[x], above[x], before[x])
        inner[x] = is_higher & (row[x] >= max(right[x], below[x], behind[x], least))


@njit(cache=True, nogil=True)
def _is_peak(sums: Sums, z: int, y: int, x: int) -> bool:
    """Whether no neighbouring cell that was voted for gathers more (of equal ones, the first counts)."""
    total = sums[z % 3, y, x]
    for c in range(z - 1, z + 2):
        for b in range(y - 1, y + 2):
            for a in range(x - 1, x + 2):
                other = sums[c % 3, b, a]
                if other > total or (other == total and (c, b, a) < (z, y, x)):
                    return False
    return True


@njit(cache=True)
def _centroid(votes: Votes, z: int, y: int, x: int, total: float) -> tuple[float, float, float]:
    sums = np.zeros(3)
    for c in range(z - 1, z + 2):
        for b in range(y - 1, y + 2):
            for a in range(x - 1, x + 2):
                sums[0] += a * float(votes[c, b, a])
                sums[1] += b * float(votes[c, b, a])
                sums[2] += c * float(votes[c, b, a])
    return sums[0] / total, sums[1] / total, sums[2] / total
