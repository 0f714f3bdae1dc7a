"""The exact search: every pairing that is consistent in distance, each weighed by its evidence.

Nodes are possible pairs (i, j); two nodes are joined when their distances agree within the gate.  A pairing is a
clique of this graph.  The depth-first search visits each clique once and leaves a branch only when no clique in
it can come within `LISTED_NATS` of the best: chi^2 never falls and the transform's volume never grows when pairs
are added.
"""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.correspondence.evidence import GATE_CHI2, filled_volume, fit, fits_as_well, is_collinear, log_misfit
from ronnaplan.correspondence.told import LEAST_PAIRS

LISTED_NATS = 18.0
"""Pairings further than this below the best in log evidence (1 in 6e7) are neither listed nor summed."""

MOST_LISTED = 2048
"""More pairings than this near the best are not listed (the layout is far from unique)."""

MOST_VISITED = 8_000
"""More cliques than this (about 10 ms): the list is given up, and poses are searched instead."""

CLEAR_OF_OTHERS = 1e-5
"""A second body less probable than this changes no answer."""

LOG_ODDS_PER_PAIR = 1.6
"""Of two bodies that both sets hold, the one with more pairs is the patient, by these log odds for each pair more:
three pairs more are needed for 0.99, and equal bodies are always refused."""

LEAST_REGULAR = 5
"""Fewer pairs fit otherwise, too, by chance; of so many it shows that the markers are laid out regularly."""


@njit(cache=True, nogil=True, error_model="numpy")
def distances(points):  # type: ignore[no-untyped-def]
    """Return all mutual distances (Eq. 10) of points (n, 3) as (n, n)."""
    n = len(points)
    d = np.zeros((n, n))
    for a in range(n):
        for b in range(a):
            x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
            d[a, b] = d[b, a] = math.sqrt(x * x + y * y + z * z)
    return d


@njit(cache=True, nogil=True, error_model="numpy")
def list_edges(dx, dy, gate, edges):  # type: ignore[no-untyped-def]
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
def consistency_graph(ct, ots, weight):  # type: ignore[no-untyped-def]
    """Return i and j of each node, the best connected first, and the adjacency as rows of bits."""
    n, m = len(ct), len(ots)
    dx, dy, gate = distances(ct), distances(ots), GATE_CHI2 / weight
    edges = np.empty((16 * n * m, 2), np.int32)
    count = list_edges(dx, dy, gate, edges)
    if count > len(edges):
        more = np.empty((count, 2), np.int32)
        list_edges(dx, dy, gate, more)
        return graph_of_edges(more, n, m)
    return graph_of_edges(edges[:count], n, m)


@njit(cache=True, nogil=True, error_model="numpy")
def graph_of_edges(edges, n, m):  # type: ignore[no-untyped-def]
    """Return what `consistency_graph` does, from its edges (E, 2)."""
    degree, rank = np.zeros(n * m, np.int64), np.empty(n * m, np.int64)
    for e in range(len(edges)):
        degree[edges[e, 0]] += 1
        degree[edges[e, 1]] += 1
    order = np.argsort(-degree, kind="mergesort")
    rank[order] = np.arange(n * m)
    adjacent = np.zeros((n * m, (n * m + 63) // 64), np.uint64)
    for e in range(len(edges)):
        a, b = rank[edges[e, 0]], rank[edges[e, 1]]
        adjacent[a, b >> 6] |= np.uint64(1) << np.uint64(b & 63)
        adjacent[b, a >> 6] |= np.uint64(1) << np.uint64(a & 63)
    return order // m, order % m, adjacent


@njit(cache=True, nogil=True, error_model="numpy")
def lowest_bit(word):  # type: ignore[no-untyped-def]
    """Return the index of the lowest set bit of a non-zero word."""
    bit, shift = 0, 32
    while shift:
        if word & ((np.uint64(1) << np.uint64(shift)) - np.uint64(1)) == np.uint64(0):
            word >>= np.uint64(shift)
            bit += shift
        shift >>= 1
    return bit


@njit(cache=True, nogil=True, error_model="numpy")
def pop_first(bits):  # type: ignore[no-untyped-def]
    """Remove and return the first node of a set of bits, -1 when it is empty."""
    for w in range(len(bits)):
        if bits[w]:
            first = 64 * w + lowest_bit(bits[w])
            bits[w] &= bits[w] - np.uint64(1)
            return first
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def count_rows(bits, node_i, seen):  # type: ignore[no-untyped-def]
    """Return how many different CT points a set's nodes have: a clique holds at most one node of each."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def keep_listed(log_evidence, partners, floor):  # type: ignore[no-untyped-def]
    """Move the entries above ``floor`` to the front; return their number."""
    kept = 0
    for a in range(len(log_evidence)):
        if log_evidence[a] >= floor:
            log_evidence[kept] = log_evidence[a]
            partners[kept] = partners[a]
            kept += 1
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def enter(log_evidence, partners, found, here, floor, lost, i, j, size):  # type: ignore[no-untyped-def]
    """Add a pairing above ``floor`` to the list; return the new length.

    A full list gives up its lower half; ``lost[0]`` remembers the highest log evidence given up.
    """
    if here < floor or here <= lost[0]:
        return found
    if found == MOST_LISTED:
        middle = max(floor, np.median(log_evidence))
        for value in log_evidence:
            if floor <= value < middle:
                lost[0] = max(lost[0], value)
        found = keep_listed(log_evidence, partners, middle)
    if found == MOST_LISTED:
        lost[0] = max(lost[0], here)
        return found
    log_evidence[found], partners[found] = here, -1
    for a in range(size):
        partners[found, i[a]] = j[a]
    return found + 1


@njit(cache=True, nogil=True, error_model="numpy")
def start_from_known(known, node_i, node_j, adjacent, i, j):  # type: ignore[no-untyped-def]
    """Enter the known pairs as the first of the clique; return the nodes that can join them."""
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
def weigh(points, weight, node_value, constants, i, j, size, reach, spread):  # type: ignore[no-untyped-def]
    """Return a clique's log evidence, and the most that a clique of up to ``reach`` pairs around it can have."""
    chi2, volume = fit(points[0], points[1], weight, i, j, size, spread)
    here = volume
    for a in range(size):
        here += node_value[i[a], j[a]]
    bound = -np.inf
    top = node_value.max()
    for k in range(size, reach + 1):
        bound = max(bound, constants[k] + (k - size) * top + log_misfit(chi2, k))
    return here + constants[size] + log_misfit(chi2, size), here + bound


@njit(cache=True, nogil=True, error_model="numpy")
def search(ct, ots, weight, node_value, constants, known, spread, nats, best):  # type: ignore[no-untyped-def]
    """List every pairing within ``nats`` of the most probable one.

    ``weight`` and ``node_value`` (n, m): 1/variance of a pair, and the pair's own share -3/2 ln c of the log
    evidence; ``constants``: see `size_priors`; ``known`` (K, 2): pairs that every pairing must hold; ``best``: a
    log evidence to start from.  Returns the log evidences (L,), the partner of each CT point in each pairing
    (L, n), -1 for none, and whether the list is complete.
    """
    n, most, given = len(ct), min(len(ct), len(ots)), len(known)
    node_i, node_j, adjacent = consistency_graph(ct, ots, weight)
    i, j = np.zeros(most + 1, np.int64), np.zeros(most + 1, np.int64)
    candidates = np.zeros((most + 2, adjacent.shape[1]), np.uint64)
    candidates[given] = start_from_known(known, node_i, node_j, adjacent, i, j)
    log_evidence, partners = np.empty(MOST_LISTED), np.empty((MOST_LISTED, n), np.int16)
    seen = np.zeros(n, np.bool_)
    found, visited, lost = 0, 0, np.full(1, -np.inf)
    least = np.argmax(np.isfinite(constants))
    if given >= LEAST_PAIRS:
        here = weigh((ct, ots), weight, node_value, constants, i, j, given, given, spread)[0]
        best = max(best, here)
        found = enter(log_evidence, partners, 0, here, best - nats, lost, i, j, given)
    depth = given
    while depth >= given:
        node = pop_first(candidates[depth])
        if node < 0:
            depth -= 1
            continue
        i[depth], j[depth] = node_i[node], node_j[node]
        size = depth + 1
        candidates[size] = candidates[depth] & adjacent[node]
        reach = min(size + count_rows(candidates[size], node_i, seen), most)
        if reach < least:
            continue
        if size >= LEAST_PAIRS:
            visited += 1
            here, bound = weigh((ct, ots), weight, node_value, constants, i, j, size, reach, spread)
            best = max(best, here)
            if bound < best - nats:
                continue
            found = enter(log_evidence, partners, found, here, best - nats, lost, i, j, size)
            if visited > MOST_VISITED:
                break
        depth = size
    found = keep_listed(log_evidence[:found], partners[:found], best - nats)
    complete = visited <= MOST_VISITED and lost[0] < best - nats
    return log_evidence[:found], partners[:found], complete


@njit(cache=True, nogil=True, error_model="numpy")
def best_of(log_evidence, background):  # type: ignore[no-untyped-def]
    """Return the index and posterior probability of the most probable pairing, (-1, 0) without any."""
    if len(log_evidence) == 0:
        return -1, 0.0
    best = np.argmax(log_evidence)
    total = math.exp(min(background - log_evidence[best], 700.0))
    for a in range(len(log_evidence)):
        total += math.exp(log_evidence[a] - log_evidence[best])
    return best, 1.0 / total


@njit(cache=True, nogil=True, error_model="numpy")
def mirror_is_better(ct, ots, weight, node_value, constants, known, spread, size, log_evidence):  # type: ignore[no-untyped-def]
    """Tell whether the mirror image of the CT points pairs more than ``size`` points, and with more evidence.

    Then one of the sets is left-handed, and what fits without a reflection is only a flat part of it.
    """
    if size >= min(len(ct), len(ots)):
        return False
    mirrored, larger = ct.copy(), constants.copy()
    mirrored[:, 0] = -mirrored[:, 0]
    larger[: size + 1] = -np.inf
    found = search(mirrored, ots, weight, node_value, larger, known, spread, 1.0, log_evidence)[0]
    return len(found) > 0 and found.max() > log_evidence


@njit(cache=True, nogil=True, error_model="numpy")
def other_body(ct, ots, weight, node_value, constants, backgrounds, volume, partner):  # type: ignore[no-untyped-def]
    """Return the number of pairs of the best body among the points that ``partner`` leaves, and if it is real.

    ``constants`` and ``backgrounds``: those of `size_priors` for each number of pairs taken away.  The second
    result is the probability that these pairs are no chance meeting; both are 0 when no three points are left.
    """
    taken = np.zeros(len(ots), np.bool_)
    for j in partner:
        if j >= 0:
            taken[j] = True
    i, j = np.flatnonzero(partner < 0), np.flatnonzero(~taken)
    if min(len(i), len(j)) < LEAST_PAIRS:
        return 0, 0.0
    size = len(ct) - len(i)
    own = constants[size, : min(len(i), len(j)) + 1].copy()
    own += (np.arange(len(own)) - 1.0) * math.log(volume)
    log_evidence, partners, _ = search(
        ct[i],
        ots[j],
        weight[i][:, j],
        node_value[i][:, j],
        own,
        np.zeros((0, 2), np.int64),
        np.inf,
        1.0,
        backgrounds[size] - 5.0,
    )
    best, p = best_of(log_evidence, backgrounds[size])
    if best < 0:
        return 0, 0.0
    return (partners[best] >= 0).sum(), p


@njit(cache=True, nogil=True, error_model="numpy")
def regular_odds(ct, ots, weight, spread, log_evidence, partners, best, background):  # type: ignore[no-untyped-def]
    """Return the odds, to the ``best`` of the listed pairings, of one that pairs the points otherwise and fits as well.

    Such points are laid out regularly, and the noise of many makes evidences differ by more than is told apart: only
    pairs more count, by `LOG_ODDS_PER_PAIR` each.  0 where nothing fits as well.
    """
    size = (partners[best] >= 0).sum()
    if size < LEAST_REGULAR:
        return 0.0
    chi2, odds = chi2_of(ct, ots, weight, partners[best], spread), 0.0
    for a in range(len(partners)):
        other = (partners[a] >= 0).sum()
        agree = ((partners[a] >= 0) & (partners[a] == partners[best])).sum()
        if other < LEAST_REGULAR or 2 * agree > other:
            continue
        real = 1.0 / (1.0 + math.exp(min(background - log_evidence[a], 700.0)))
        here = real * math.exp(-LOG_ODDS_PER_PAIR * max(size - other, 0))
        if here > odds and fits_as_well(chi2, size, chi2_of(ct, ots, weight, partners[a], spread), other):
            odds = here
    return odds


@njit(cache=True, nogil=True, error_model="numpy")
def chi2_of(ct, ots, weight, partner, spread):  # type: ignore[no-untyped-def]
    """Return the chi^2 of a pairing, given as the partner of each CT point."""
    i = np.flatnonzero(partner >= 0)
    return fit(ct, ots, weight, i, partner[i].astype(np.int64), len(i), spread)[0]


@njit(cache=True, nogil=True, error_model="numpy")
def match_many(ct, ots, variance, sizes, residual, spread):  # type: ignore[no-untyped-def]
    """Match T sets (T, n, 3), (T, m, 3) of one variance: partners (T, n) and probability (T,) of the best.

    ``sizes`` and ``residual``: what `priors.size_priors` and `priors.residual_priors` return.  A probability of 0
    marks what has to be looked at more closely: a search that gave up, points on a line, a set whose mirror image
    fits better, a second body, and regular markers.
    """
    tests, n, m = len(ct), ct.shape[1], ots.shape[1]
    weight, node_value = np.full((n, m), 1.0 / variance), np.full((n, m), -1.5 * math.log(variance))
    known = np.zeros((0, 2), np.int64)
    partners, probability = np.full((tests, n), -1, np.int16), np.zeros(tests)
    size_constants, background = sizes
    steps = np.arange(len(size_constants)) - 1.0
    for t in range(tests):
        volume = filled_volume(ct[t], ots[t])
        constants = size_constants + steps * math.log(volume)
        log_evidence, listed, complete = search(
            ct[t], ots[t], weight, node_value, constants, known, spread, LISTED_NATS, -np.inf
        )
        best, p = best_of(log_evidence, background)
        if best < 0:
            continue
        partners[t] = listed[best]
        paired, top = listed[best] >= 0, log_evidence[best]
        if not complete or is_collinear(ct[t][paired], math.sqrt(variance)):
            continue
        body = other_body(ct[t], ots[t], weight, node_value, residual[0], residual[1], volume, listed[best])
        regular = regular_odds(ct[t], ots[t], weight, spread, log_evidence, listed, best, background)
        if max(body[1], regular) > CLEAR_OF_OTHERS:
            continue
        size = paired.sum()
        if not mirror_is_better(ct[t], ots[t], weight, node_value, constants, known, spread, size, top):
            probability[t] = p
    return partners, probability
