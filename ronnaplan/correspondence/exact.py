"""The exact search: every pairing that is consistent in distance, each weighed by its evidence.

A pairing is a clique of the graph of what goes together (`graph`). The depth-first search visits each clique once and
leaves a branch only when no clique in it can come within `LISTED_NATS` of the best: chi^2 never falls and the
transform's volume never grows when pairs are added.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.correspondence.evidence import fit, log_misfit, odds_from_log
from ronnaplan.correspondence.graph import consistency_graph, count_rows, pop_first
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.geometry import FloatArray

LISTED_NATS = 18.0
"""Pairings further than this below the best in log evidence (1 in 6e7) are neither listed nor summed."""

MOST_LISTED = 2048
"""More pairings than this near the best are not listed (the layout is far from unique)."""

MOST_VISITED = 8_000
"""More cliques than this (about 10 ms): the list is given up, and poses are searched instead."""


class Listed(NamedTuple):
    """Room for the pairings that are listed, for the kernels: as many as have been found count."""

    log_evidence: FloatArray
    chi2: FloatArray
    partners: NDArray[np.int16]
    """Of each CT point in each pairing, -1 for none."""
    lost: FloatArray
    """The highest log evidence that was given up (1,)."""


@njit(cache=True, nogil=True, error_model="numpy")
def in_volume(constants: FloatArray, volume: float) -> FloatArray:
    """Return the constants (K,) of `size_priors` with what outliers in a volume (mm^3) add: (k - 1) ln V of k pairs."""
    return constants + (np.arange(len(constants)) - 1.0) * math.log(volume)


@njit(cache=True, nogil=True, error_model="numpy")
def keep_listed(listed: Listed, found: int, floor: float) -> int:
    """Move those of the pairings ``found`` that are above ``floor`` to the front; return their number."""
    kept = 0
    for a in range(found):
        if listed.log_evidence[a] >= floor:
            listed.log_evidence[kept], listed.chi2[kept] = listed.log_evidence[a], listed.chi2[a]
            for i in range(listed.partners.shape[1]):
                listed.partners[kept, i] = listed.partners[a, i]
            kept += 1
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def enter(
    listed: Listed, found: int, here: float, its_chi2: float, floor: float, i: IntArray, j: IntArray, size: int
) -> int:
    """Add a pairing (``size``,) above ``floor`` to those ``found``; return how many there are then.

    A full list gives up its lower half.
    """
    lost = listed.lost
    if here < floor or here <= lost[0]:
        return found
    if found == MOST_LISTED:
        middle = max(floor, np.median(listed.log_evidence))
        for value in listed.log_evidence:
            if floor <= value < middle:
                lost[0] = max(lost[0], value)
        found = keep_listed(listed, found, middle)
    if found == MOST_LISTED:
        lost[0] = max(lost[0], here)
        return found
    listed.log_evidence[found], listed.chi2[found], listed.partners[found] = here, its_chi2, -1
    for a in range(size):
        listed.partners[found, i[a]] = j[a]
    return found + 1


@njit(cache=True, nogil=True, error_model="numpy")
def start_from_known(
    known: IntArray, node_i: IntArray, node_j: IntArray, adjacent: NDArray[np.uint64], i: IntArray, j: IntArray
) -> NDArray[np.uint64]:
    """Enter the known pairs (K, 2) as the first of the clique; return the nodes that can join them, as bits."""
    nodes = len(node_i)
    candidates = np.zeros(adjacent.shape[1], np.uint64)
    for a in range(nodes):
        candidates[a >> 6] |= np.uint64(1) << np.uint64(a & 63)
    for q in range(len(known)):
        i[q], j[q] = known[q, 0], known[q, 1]
        for a in range(nodes):
            if node_i[a] == i[q] and node_j[a] == j[q]:
                candidates &= adjacent[a]
    return candidates


@njit(cache=True, nogil=True, error_model="numpy")
def weigh(
    points: tuple[FloatArray, FloatArray],
    weight: FloatArray,
    node_value: FloatArray,
    constants: FloatArray,
    i: IntArray,
    j: IntArray,
    size: int,
    reach: int,
    spread: float,
) -> tuple[float, float, float]:
    """Return a clique's log evidence, its chi^2, and the most that one of up to ``reach`` pairs around it can have."""
    chi2, volume = fit(points[0], points[1], weight, i, j, size, spread)
    here = volume
    for a in range(size):
        here += node_value[i[a], j[a]]
    bound = -np.inf
    top = node_value.max()
    for k in range(size, reach + 1):
        bound = max(bound, constants[k] + (k - size) * top + log_misfit(chi2, k))
    return here + constants[size] + log_misfit(chi2, size), chi2, here + bound


@njit(cache=True, nogil=True, error_model="numpy")
def search(
    ct: FloatArray,
    ots: FloatArray,
    weight: FloatArray,
    node_value: FloatArray,
    constants: FloatArray,
    known: IntArray,
    spread: float,
    nats: float,
    best: float,
    gate_chi2: float,
) -> tuple[FloatArray, FloatArray, NDArray[np.int16], bool]:
    """List every pairing within ``nats`` of the most probable one.

    ``weight`` and ``node_value`` (n, m): 1/variance of a pair, and the pair's own share -3/2 ln c of the log
    evidence; ``constants``: see `size_priors`; ``known`` (K, 2): pairs that every pairing must hold; ``best``: a
    log evidence to start from; ``gate_chi2``: of two pairs, at most.  Returns the log evidences (L,), the chi^2 (L,),
    the partner of each CT point in each pairing (L, n), -1 for none, and whether the list is complete.
    """
    n, most, given = len(ct), min(len(ct), len(ots)), len(known)
    node_i, node_j, adjacent = consistency_graph(ct, ots, weight, gate_chi2)
    i, j = np.zeros(most + 1, np.int64), np.zeros(most + 1, np.int64)
    candidates = np.zeros((most + 2, adjacent.shape[1]), np.uint64)
    started = start_from_known(known, node_i, node_j, adjacent, i, j)
    for word in range(len(started)):
        candidates[given, word] = started[word]
    partners, lost = np.empty((MOST_LISTED, n), np.int16), np.full(1, -np.inf)
    listed = Listed(np.empty(MOST_LISTED), np.empty(MOST_LISTED), partners, lost)
    found, visited, seen = 0, 0, np.zeros(n, np.bool_)
    least = np.argmax(np.isfinite(constants))
    if given >= LEAST_PAIRS:
        here, misfit, _ = weigh((ct, ots), weight, node_value, constants, i, j, given, given, spread)
        best = max(best, here)
        found = enter(listed, 0, here, misfit, best - nats, i, j, given)
    depth = given
    while depth >= given:
        node = pop_first(candidates[depth])
        if node < 0:
            depth -= 1
            continue
        i[depth], j[depth] = node_i[node], node_j[node]
        size = depth + 1
        for word in range(len(started)):
            candidates[size, word] = candidates[depth, word] & adjacent[node, word]
        reach = min(size + count_rows(candidates[size], node_i, seen), most)
        if reach < least:
            continue
        if size >= LEAST_PAIRS:
            visited += 1
            here, misfit, bound = weigh((ct, ots), weight, node_value, constants, i, j, size, reach, spread)
            best = max(best, here)
            if bound < best - nats:
                continue
            found = enter(listed, found, here, misfit, best - nats, i, j, size)
            if visited > MOST_VISITED:
                break
        depth = size
    found = keep_listed(listed, found, best - nats)
    complete = visited <= MOST_VISITED and (found == 0 or lost[0] < best - nats)
    return listed.log_evidence[:found], listed.chi2[:found], partners[:found], complete


@njit(cache=True, nogil=True, error_model="numpy")
def best_of(log_evidence: FloatArray, background: float) -> tuple[int, float]:
    """Return index and posterior probability of the most probable pairing by evidences (L,), (-1, 0) without any."""
    if len(log_evidence) == 0:
        return -1, 0.0
    best = int(np.argmax(log_evidence))
    total = odds_from_log(background - log_evidence[best])
    for a in range(len(log_evidence)):
        total += math.exp(log_evidence[a] - log_evidence[best])
    return best, 1.0 / total


@njit(cache=True, nogil=True, error_model="numpy")
def not_by_chance(log_evidence: float, background: float) -> float:
    """Return the probability that pairs of such evidence do not meet by chance, which has that of the background."""
    return 1.0 / (1.0 + odds_from_log(background - log_evidence))
