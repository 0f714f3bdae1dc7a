"""Correspondence against its peers: right, refused and false answers, and time, on the same simulated heads.

    python -m benchmarks.correspondence peers|large [--tests N] [--seed N]

The peers align point clouds and state neither a probability nor a refusal.  Each is given the same acceptance
test: its answer counts when its pose brings exactly the expected number of mutually nearest points within 3 mm,
and it refuses otherwise.  Open3D and KISS-Matcher get every CT point joined with every OTS point as putative
correspondences, for markers have no descriptors; pycpd gets centered sets.  These three are skipped where they are not
installed.
Times are processor times, so that other work on the machine does not count.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.matchers import ACCEPT_MM, Pairs, dense_clique, exhaustive, hungarian_icp
from ronnaplan.correspondence import match_by_similarity, match_points
from ronnaplan.geometry import FloatArray
from ronnaplan.rigid import fit_closed_form
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.studies.heads import HEADS_MM
from ronnaplan.studies.scenes import random_rotations, simulate_scenes, uniform_in_ball
from ronnaplan.transforms import transform_points

CASES = ((3, 0), (3, 4), (4, 0), (4, 4), (8, 0), (8, 4))
GIVEN_SHARE = 0.8
"""An answer is right where no pair of it is wrong and so many of the markers are paired."""

LARGE_CASES = (
    *((10, 22, field, 0) for field in (300.0, 90.0, 45.0)),
    *((20, 40, field, 0) for field in (300.0, 90.0, 45.0)),
    *((40, 160, field, 0) for field in (300.0, 90.0, 45.0)),
    (100, 100, 90.0, 0),
    (100, 400, 300.0, 0),
    (500, 500, 90.0, 0),
    (24, 0, 300.0, 20),
    (24, 40, 300.0, 20),
    (20, 0, 300.0, 20),
)

Matcher = Callable[[FloatArray, FloatArray, int], Pairs]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("peers", "large"), help="small sets and all matchers, or large sets")
    parser.add_argument("--tests", type=int, default=200, help="tests a case")
    parser.add_argument("--seed", type=int, default=20_260)
    arguments = parser.parse_args()
    table = {"peers": small_table, "large": large_table}[arguments.what]
    print(table(arguments.tests, arguments.seed))


def small_table(tests: int, seed: int) -> str:
    """Return the table of all matchers on marker sets."""
    matchers: dict[str, Matcher] = {
        "exact": exact,
        "published, one to one": published,
        "published, any partner": published_any,
        "exhaustive, chi2 gap": exhaustive,
        "dense clique": dense_clique,
        "PCA + ICP": pca_icp,
        "Hungarian + ICP": hungarian_icp,
    }
    matchers |= open3d_matchers() | kiss_matchers() | pycpd_matchers()
    lines = [
        "| markers + outliers | matcher | right % | refused % | wrong % | median ms | worst ms |",
        "|---|---|---|---|---|---|---|",
    ]
    for markers, outliers in CASES:
        scenes = simulate_scenes(np.random.default_rng(seed), HEADS_MM[0], tests, markers, outliers)
        for name, matcher in matchers.items():
            matcher(scenes.ct[0], scenes.ots[0], markers)
            right = refused = 0
            times = []
            for ct, ots, partner in zip(scenes.ct, scenes.ots, scenes.partner, strict=True):
                start = time.process_time()
                pairs = matcher(ct, ots, markers)
                times.append(1000 * (time.process_time() - start))
                refused += len(pairs) == 0
                right += np.array_equal(pairs, np.column_stack((np.arange(markers), partner[:markers])))
            shares = [100 * count / tests for count in (right, refused, tests - right - refused)]
            cells = [f"{markers} + {outliers}", name, *(f"{share:.1f}" for share in shares)]
            lines.append(f"| {' | '.join(cells)} | {np.median(times):.2f} | {max(times):.2f} |")
    return "\n".join([*lines, ""])


def exact(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
    """Pair by `match_points`."""
    return match_points(ct, ots, expected).pairs


def published(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
    """Pair by the published algorithm."""
    return match_by_similarity(ct, ots, expected).pairs


def published_any(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
    """Pair by the published algorithm, counting every distance that has any partner."""
    return match_by_similarity(ct, ots, expected, one_to_one=False).pairs


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


def kiss_matchers() -> dict[str, Matcher]:
    """Return KISS-Matcher's pruning and solver, none when it is not installed."""
    try:
        import kiss_matcher
    except ImportError as error:
        print(f"KISS-Matcher is left out: {error}")
        return {}

    def prune_and_solve(ct: FloatArray, ots: FloatArray, expected: int) -> Pairs:
        i, j = np.indices((len(ct), len(ots))).reshape(2, -1)
        config = kiss_matcher.KISSMatcherConfig(ACCEPT_MM, enable_noise_bound_clamping=False)
        found = kiss_matcher.KISSMatcher(config).prune_and_solve(list(ct[i]), list(ots[j]))
        return accept(ct, ots, pose(np.asarray(found.rotation), np.asarray(found.translation)), expected)

    return {"KISS-Matcher": prune_and_solve}


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


def large_table(tests: int, seed: int) -> str:
    """Return the table of larger sets: compact markers, wider, equal and narrower outliers, second bodies."""
    lines = [
        "| markers | outliers | in a field of mm | second body | right | refused | too few given | wrong "
        "| pose right, no marker wrong | chance pairs given | median ms | worst ms |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    match_points(*body_scene(np.random.default_rng(0), 20, 30, 300.0, 0)[:2])
    for markers, outliers, field, second in LARGE_CASES:
        right = refused = few = sound = chance = 0
        times = []
        for test in range(tests):
            ct, ots, partner = body_scene(np.random.default_rng([seed, test]), markers, outliers, field, second)
            start = time.process_time()
            pairs = match_points(ct, ots).pairs
            times.append(1000 * (time.process_time() - start))
            own = pairs[pairs[:, 0] < markers]
            true = bool((partner[own[:, 0]] == own[:, 1]).all()) and len(own) > 0
            enough = len(own) >= GIVEN_SHARE * markers
            refused += len(pairs) == 0
            right += true and enough
            few += true and not enough
            sound += true and is_pose_right(ct, ots, pairs, partner)
            chance += true and len(own) < len(pairs)
        wrong = tests - right - refused - few
        cells = [markers, outliers, f"{field:g}", second or "", right, refused, few, wrong, sound, chance]
        lines.append(f"| {' | '.join(map(str, cells))} | {np.median(times):.0f} | {max(times):.0f} |")
    return "\n".join([*lines, ""])


def is_pose_right(ct: FloatArray, ots: FloatArray, pairs: Pairs, partner: Pairs) -> bool:
    """Tell whether the pose that pairs give brings all markers, also those not given, to their readings."""
    i = np.flatnonzero(partner >= 0)
    off = transform_points(fit_closed_form(ct[pairs[:, 0]], ots[pairs[:, 1]]), ct[i]) - ots[partner[i]]
    return bool(np.linalg.norm(off, axis=1).max() < ACCEPT_MM)


def body_scene(
    rng: np.random.Generator, markers: int, outliers: int, field_mm: float, second: int
) -> tuple[FloatArray, FloatArray, Pairs]:
    """Return a CT set, an OTS set and the true partners of the markers, which lie within 90 mm.

    ``second``: markers of another body, as wide as the field, that moved against the first.
    """
    body, other = uniform_in_ball(rng, (markers,), 90.0), uniform_in_ball(rng, (second,), field_mm)
    moved = other @ random_rotations(rng, 1)[0].T + rng.uniform(-80.0, 80.0, 3)
    ct, ots = (
        np.vstack((true + s * rng.standard_normal(true.shape), uniform_in_ball(rng, (outliers,), field_mm)))
        for s, true in ((SIGMA_CT_MM, np.vstack((body, other))), (SIGMA_OTS_MM, np.vstack((body, moved))))
    )
    order = rng.permutation(len(ots))
    partner = np.where(np.arange(len(ct)) < markers, np.argsort(order), -1)
    return ct, ots[order] @ random_rotations(rng, 1)[0].T + 500.0, partner


if __name__ == "__main__":
    main()
