"""Correspondence against its peers: right, refused and false answers, and time, on the same simulated heads.

    python -m benchmarks.correspondence [--tests N] [--large]

The peers align point clouds and state neither a probability nor a refusal.  Each is given the same acceptance
test: its answer counts when its pose brings exactly the expected number of mutually nearest points within 3 mm,
and it refuses otherwise.  Open3D gets every CT point joined with every OTS point as putative correspondences, for
markers have no descriptors; pycpd gets centred sets.  Open3D and pycpd are skipped where they are not installed.
Times are processor times, so that other work on the machine does not count.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ronnaplan.correspondence import match_by_similarity, match_points
from ronnaplan.geometry import FloatArray
from ronnaplan.studies.heads import HEADS_MM
from ronnaplan.studies.scenes import random_rotations, simulate_scenes, uniform_in_ball

ACCEPT_MM = 3.0
CASES = ((3, 0), (3, 4), (4, 0), (4, 4), (8, 0), (8, 4))
LARGE_CASES = ((200, 300.0), (200, 100.0), (1000, 300.0))

Pairs = NDArray[np.int64]
Matcher = Callable[[FloatArray, FloatArray, int], Pairs]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tests", type=int, default=200, help="tests a case")
    parser.add_argument("--large", action="store_true", help="also sets of 200 and 1,000 points, half outliers")
    arguments = parser.parse_args()
    print(small_table(arguments.tests))
    if arguments.large:
        print(large_table())


def small_table(tests: int) -> str:
    """Return the table of all matchers on marker sets."""
    matchers = (
        {"exact": exact, "published": published, "PCA + ICP": pca_icp} | open3d_matchers() | pycpd_matchers()
    )
    lines = [
        "| markers + outliers | matcher | right % | refused % | false % | CPU ms a match | times exact |",
        "|---|---|---|---|---|---|---|",
    ]
    for markers, outliers in CASES:
        scenes = simulate_scenes(np.random.default_rng(1), HEADS_MM[0], tests, markers, outliers)
        own_ms = None
        for name, matcher in matchers.items():
            matcher(scenes.ct[0], scenes.ots[0], markers)
            right = refused = 0
            start = time.process_time()
            for ct, ots, partner in zip(scenes.ct, scenes.ots, scenes.partner, strict=True):
                pairs = matcher(ct, ots, markers)
                refused += len(pairs) == 0
                right += np.array_equal(pairs, np.column_stack((np.arange(markers), partner[:markers])))
            ms = 1000 * (time.process_time() - start) / tests
            own_ms = own_ms or ms
            shares = [100 * count / tests for count in (right, refused, tests - right - refused)]
            cells = [f"{markers} + {outliers}", name, *(f"{share:.1f}" for share in shares)]
            lines.append(f"| {' | '.join(cells)} | {ms:.2f} | {ms / own_ms:.1f} |")
    return "\n".join([*lines, ""])


def exact(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
    """Pair by `match_points`."""
    return match_points(ct, ots, expected).pairs


def published(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
    """Pair by the published algorithm."""
    return match_by_similarity(ct, ots, expected).pairs


def pca_icp(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
    """Align principal axes in each of the four proper ways, run ICP from each, keep the closest."""
    x, y = ct - ct.mean(axis=0), ots - ots.mean(axis=0)
    axes_x, axes_y = np.linalg.svd(x.T @ x)[0], np.linalg.svd(y.T @ y)[0]
    best: tuple[float, FloatArray] = (np.inf, np.eye(4))
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        turn = axes_y @ np.diag([*signs, 1]) @ axes_x.T
        turn = axes_y @ np.diag([*signs, np.sign(np.linalg.det(turn))]) @ axes_x.T
        shift = ots.mean(axis=0) - turn @ ct.mean(axis=0)
        tree = cKDTree(ots)
        for _ in range(30):
            distance, nearest = map(np.asarray, tree.query(ct @ turn.T + shift))
            used = distance <= np.sort(distance)[expected - 1]
            u, v = ct[used], ots[nearest[used]]
            left, _, right = np.linalg.svd((v - v.mean(axis=0)).T @ (u - u.mean(axis=0)))
            turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
            shift = v.mean(axis=0) - turn @ u.mean(axis=0)
        error = float(np.sort(tree.query(ct @ turn.T + shift)[0])[:expected].sum())
        if error < best[0]:
            best = error, pose(turn, shift)
    return accept(ct, ots, best[1], expected)


def open3d_matchers() -> dict[str, Matcher]:
    """Return Open3D's RANSAC and fast global registration, none when it is not installed."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        print(f"Open3D is left out: {error}")
        return {}
    pipelines = open3d.pipelines.registration

    def clouds(ct: FloatArray, ots: FloatArray) -> tuple[object, object, object]:
        first, second = (open3d.geometry.PointCloud(open3d.utility.Vector3dVector(p)) for p in (ct, ots))
        i, j = np.indices((len(ct), len(ots))).reshape(2, -1)
        return first, second, open3d.utility.Vector2iVector(np.column_stack((i, j)).astype(np.int32))

    def ransac(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
        first, second, putative = clouds(ct, ots)
        found = pipelines.registration_ransac_based_on_correspondence(
            first,
            second,
            putative,
            ACCEPT_MM,
            pipelines.TransformationEstimationPointToPoint(),
            3,
            [pipelines.CorrespondenceCheckerBasedOnEdgeLength(0.9)],
            pipelines.RANSACConvergenceCriteria(100_000, 0.999),
        )
        return accept(ct, ots, np.asarray(found.transformation), expected)

    def fast_global(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
        first, second, putative = clouds(ct, ots)
        option = pipelines.FastGlobalRegistrationOption(maximum_correspondence_distance=ACCEPT_MM)
        found = pipelines.registration_fgr_based_on_correspondence(first, second, putative, option)
        return accept(ct, ots, np.asarray(found.transformation), expected)

    return {"Open3D RANSAC": ransac, "Open3D FGR": fast_global}


def pycpd_matchers() -> dict[str, Matcher]:
    """Return coherent point drift, none when it is not installed."""
    try:
        from pycpd import RigidRegistration
    except ImportError as error:
        print(f"pycpd is left out: {error}")
        return {}

    def drift(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
        outliers = min(max(1 - expected / len(ct), 0.01), 0.9)
        from_ct, from_ots = ct.mean(axis=0), ots.mean(axis=0)
        found = RigidRegistration(X=ots - from_ots, Y=ct - from_ct, scale=False, w=outliers)
        found.register()
        _, turn, shift = found.get_registration_parameters()
        return accept(ct, ots, pose(turn.T, shift + from_ots - turn.T @ from_ct), expected)

    return {"pycpd rigid": drift}


def pose(turn: FloatArray, shift: FloatArray) -> FloatArray:
    """Return a pose as a matrix (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, np.ravel(shift)
    return matrix


def accept(ct: FloatArray, ots: FloatArray, matrix: FloatArray, expected: int) -> Pairs:
    """Return the mutually nearest points within 3 mm when they are as many as expected, else no pairs."""
    if not np.isfinite(matrix).all():
        return np.zeros((0, 2), dtype=np.int64)
    moved = ct @ matrix[:3, :3].T + matrix[:3, 3]
    distance, forth = map(np.asarray, cKDTree(ots).query(moved))
    back = np.asarray(cKDTree(moved).query(ots)[1])
    i = np.flatnonzero((distance < ACCEPT_MM) & (back[forth] == np.arange(len(ct))))
    return np.column_stack((i, forth[i])) if len(i) == expected else np.zeros((0, 2), dtype=np.int64)


def large_table() -> str:
    """Return the table of large sets, half of either set outliers."""
    lines = [
        "| points | field radius mm | status | pairs given | wrong | doubtful | CPU s |",
        "|---|---|---|---|---|---|---|",
    ]
    ct, ots, _ = cloud(np.random.default_rng(9), 60, 300.0)
    match_points(ct, ots)
    for count, radius in LARGE_CASES:
        for seed in range(3):
            ct, ots, partner = cloud(np.random.default_rng(seed), count, radius)
            start = time.process_time()
            answer = match_points(ct, ots)
            seconds = time.process_time() - start
            wrong = int((partner[answer.pairs[:, 0]] != answer.pairs[:, 1]).sum())
            lines.append(
                f"| {count} | {radius:g} | {answer.status} | {len(answer.pairs)} | {wrong} "
                f"| {len(answer.doubtful)} | {seconds:.2f} |"
            )
    return "\n".join([*lines, ""])


def cloud(rng: np.random.Generator, count: int, radius: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a large CT set, an OTS set and the true partners, half of either set outliers."""
    half = count // 2
    markers = uniform_in_ball(rng, (half,), radius)
    ct, ots = (
        np.vstack((markers + s * rng.standard_normal(markers.shape), uniform_in_ball(rng, (half,), radius)))
        for s in (0.56, 0.17)
    )
    order = rng.permutation(count)
    partner = np.full(count, -1)
    partner[:half] = np.argsort(order)[:half]
    return ct, ots[order] @ random_rotations(rng, 1)[0].T + 500.0, partner


if __name__ == "__main__":
    main()
