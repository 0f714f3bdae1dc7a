"""Which pairs go together: a graph whose nodes are possible pairs (i, j), joined where their distances agree."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.geometry import FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def distances(points: FloatArray) -> FloatArray:
    """Return all mutual distances (Eq. 10) of points (n, 3) as (n, n)."""
    n = len(points)
    d = np.zeros((n, n))
    for a in range(n):
        for b in range(a):
            x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
            d[a, b] = d[b, a] = math.sqrt(x * x + y * y + z * z)
    return d


@njit(cache=True, nogil=True, error_model="numpy")
def list_edges(dx: FloatArray, dy: FloatArray, gate: FloatArray, edges: NDArray[np.int32]) -> int:
    """Enter the graph's edges, nodes i * m + j, as far as ``edges`` (E, 2) holds; return their number."""
    n, m = len(dx), len(dy)
    widest = math.sqrt(2.0 * gate.max())
    count = 0
    for a in range(n):
        for b in range(a + 1, n):
            low, high = dx[a, b] - widest, dx[a, b] + widest
            for c in range(m):
                row = dy[c]
                for d in range(m):
                    near = low <= row[d] <= high and c != d
                    if near and (dx[a, b] - row[d]) ** 2 <= gate[a, c] + gate[b, d]:
                        if count < len(edges):
                            edges[count, 0], edges[count, 1] = a * m + c, b * m + d
                        count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def consistency_graph(
    ct: FloatArray, ots: FloatArray, weight: FloatArray, gate_chi2: float
) -> tuple[IntArray, IntArray, NDArray[np.uint64]]:
    """Return i and j (N,) of each node, the best connected first, and the adjacency as rows of bits (N, words)."""
    n, m = len(ct), len(ots)
    dx, dy, gate = distances(ct), distances(ots), gate_chi2 / weight
    edges = np.empty((16 * n * m, 2), np.int32)
    count = list_edges(dx, dy, gate, edges)
    if count > len(edges):
        more = np.empty((count, 2), np.int32)
        list_edges(dx, dy, gate, more)
        return graph_of_edges(more, n, m)
    return graph_of_edges(edges[:count], n, m)


@njit(cache=True, nogil=True, error_model="numpy")
def graph_of_edges(edges: NDArray[np.int32], n: int, m: int) -> tuple[IntArray, IntArray, NDArray[np.uint64]]:
    """Return what `consistency_graph` does, from its edges (E, 2)."""
    degree, rank = np.zeros(n * m, np.int64), np.empty(n * m, np.int64)
    for e in range(len(edges)):
        degree[edges[e, 0]] += 1
        degree[edges[e, 1]] += 1
    order = np.argsort(-degree, kind="mergesort")
    for place in range(n * m):
        rank[order[place]] = place
    adjacent = np.zeros((n * m, (n * m + 63) // 64), np.uint64)
    for e in range(len(edges)):
        a, b = rank[edges[e, 0]], rank[edges[e, 1]]
        adjacent[a, b >> 6] |= np.uint64(1) << np.uint64(b & 63)
        adjacent[b, a >> 6] |= np.uint64(1) << np.uint64(a & 63)
    return order // m, order % m, adjacent


@njit(cache=True, nogil=True, error_model="numpy")
def lowest_bit(word: np.uint64) -> int:
    """Return the index of the lowest set bit of a non-zero word."""
    bit, shift = 0, 32
    while shift:
        if word & ((np.uint64(1) << np.uint64(shift)) - np.uint64(1)) == np.uint64(0):
            word >>= np.uint64(shift)
            bit += shift
        shift >>= 1
    return bit


@njit(cache=True, nogil=True, error_model="numpy")
def pop_first(bits: NDArray[np.uint64]) -> int:
    """Remove and return the first node of a set of bits (W,), -1 when it is empty."""
    for w in range(len(bits)):
        if bits[w]:
            first = 64 * w + lowest_bit(bits[w])
            bits[w] &= bits[w] - np.uint64(1)
            return first
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def count_rows(bits: NDArray[np.uint64], node_i: IntArray, seen: NDArray[np.bool_]) -> int:
    """Return how many CT points the nodes of a set (W,) have: a clique holds at most one node of each."""
    seen[:] = False
    rows = 0
    for w in range(len(bits)):
        rest = bits[w]
        while rest:
            i = node_i[64 * w + lowest_bit(rest)]
            rest &= rest - np.uint64(1)
            if not seen[i]:
                seen[i] = True
                rows += 1
    return rows
