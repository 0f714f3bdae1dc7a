"""Predicted target error against Monte Carlo: of heads, of up to 1,000 points, and where a rotation is uncertain.

    python -m benchmarks.tre [--layouts N] [--seed N] [--effort X] [--markers N ...]

Equal isotropic errors are registered here by a plain Kabsch fit that shares nothing with the package; others by the
package's likelihood fit. The peer's `compute_tre_from_fle` knows no anisotropic errors; release 0.8.3 takes the rows of
the matrix of principal axes where the axes are its columns, hence its errors.
"""

from __future__ import annotations

import argparse
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan.geometry import FloatArray, rms_mm
from ronnaplan.registration import predict_tre, register_batch
from ronnaplan.registration.planned import planned_pose
from ronnaplan.report.tables import align
from ronnaplan.transforms import point_jacobian, rotation_sd_deg

SIGMA_MM = 0.35
MOVING_SHARES = (0.0, 0.2, 0.5, 0.9)
"""Shares of the variance that the moving side has."""
LOOSE_DEG = (5.0, 8.0)
CHUNK_POINTS, FITTED_POINTS = 200_000, 100_000
LARGEST_UNEQUAL = 40
"""Likelihood fits of more points take too long for a column."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--layouts", type=int, default=10, help="random layouts a number of markers")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--effort", type=float, default=1.0, help="Monte Carlo trials, as a multiple of the usual ones"
    )
    parser.add_argument("--markers", type=int, nargs="+", default=[3, 4, 6, 12, 40, 200, 1000])
    arguments = parser.parse_args()
    print(heads_table(arguments.markers, arguments.layouts, arguments.seed, arguments.effort))
    print()
    print(loose_table(arguments.markers, arguments.seed, arguments.effort))


def heads_table(counts: list[int], layouts: int, seed: int, effort: float) -> str:
    """Largest departure of the predicted from the simulated RMS TRE, in percent."""
    from sksurgerycore.algorithms.errors import compute_tre_from_fle

    rows = [["markers", "isotropic: ronnaplan", "scikit-surgerycore", "anisotropic: ronnaplan", ""]]
    for count in counts:
        rng = np.random.default_rng([seed, count])
        worst = np.zeros(3)
        for _ in range(layouts):
            markers, target = random_layout(rng, count)
            equal = np.tile(SIGMA_MM**2 * np.eye(3), (count, 1, 1))
            observed = simulated_tre(rng, markers, target, (0.8 * equal, 0.2 * equal), trials(effort, count))[0]
            own = rms_mm(predict_tre(markers, (0.8 * equal, 0.2 * equal), target))[0]
            peer = np.sqrt(compute_tre_from_fle(markers, 3 * SIGMA_MM**2, target))
            both = random_covariances(rng, count), random_covariances(rng, count)
            off = [own / observed[0] - 1, float(peer) / observed[0] - 1, 0.0]
            if count <= LARGEST_UNEQUAL:
                other = simulated_tre(rng, markers, target, both, trials(effort, count, equal=False), equal=False)[
                    0
                ][0]
                off[2] = rms_mm(predict_tre(markers, both, target))[0] / other - 1
            worst = np.maximum(worst, 100 * np.abs(off))
        rows.append([str(count), *(f"{value:.1f} %" if value else "not run" for value in worst), ""])
        print(rows[-1], flush=True)
    return f"Largest error of the predicted RMS TRE over {layouts} layouts\n{align(rows)}"


def loose_table(counts: list[int], seed: int, effort: float) -> str:
    """Largest departure where the layout leaves a rotation uncertain: of markers as planned, and as fitted."""
    heads = [f"{kind}, {degrees:g} degrees" for degrees, kind in product(LOOSE_DEG, ("planned", "fitted"))]
    rows = [["markers", *heads, ""]]
    for count in counts:
        rng = np.random.default_rng([seed, count])
        worst = np.zeros(4)
        cases = product(("row", "plate", "ball"), MOVING_SHARES, (True, False))
        for shape, share, equal in cases:
            if not equal and count > LARGEST_UNEQUAL:
                continue
            points = loose_layout(rng, shape, count)
            targets = rng.uniform(-60, 60, (4, 3))
            unit = np.tile(np.eye(3), (count, 1, 1)) if equal else random_covariances(rng, count)
            for k, degrees in enumerate(LOOSE_DEG):
                errors = as_loose_as(points, share * unit, (1 - share) * unit, degrees)
                runs = trials(effort if equal else effort / 4, count, equal=equal)
                observed, stated = simulated_tre(rng, points, targets, errors, runs, equal=equal)
                off = [rms_mm(predict_tre(points, errors, targets)) / observed - 1, stated / observed - 1]
                worst[2 * k : 2 * k + 2] = np.maximum(worst[2 * k : 2 * k + 2], 100 * np.abs(off).max(axis=1))
        rows.append([str(count), *(f"{value:.1f} %" for value in worst), ""])
        print(rows[-1], flush=True)
    title = "The same where a rotation is uncertain: rows, plates and balls, errors of one side and of both"
    return f"{title}\n{align(rows)}"


def trials(effort: float, count: int, *, equal: bool = True) -> int:
    """Return how many registrations of so many markers to simulate."""
    return int(effort * (1e5 if equal else np.clip(3e6 / count, 1e4, 1e5)))


def random_layout(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """Return markers (count, 3), not nearly on one line, and a target (1, 3) in a head-sized ball."""
    while True:
        places = rng.normal(size=(count + 1, 3))
        places *= (90 * rng.random(count + 1) ** (1 / 3) / np.linalg.norm(places, axis=1))[:, None]
        markers = places[:count]
        if np.linalg.svd(markers - markers.mean(axis=0), compute_uv=False)[1] > 25:
            return markers, places[count:]


def loose_layout(rng: np.random.Generator, shape: str, count: int) -> FloatArray:
    """Return points (count, 3) near a line, near a plane, or in a ball, turned any way."""
    sizes = {"row": (40.0, 6.0, 6.0), "plate": (40.0, 40.0, 3.0), "ball": (35.0, 35.0, 35.0)}[shape]
    return np.asarray((rng.normal(size=(count, 3)) * sizes) @ Rotation.random(rng=rng).as_matrix().T)


def random_covariances(rng: np.random.Generator, count: int) -> FloatArray:
    """Return covariances (count, 3, 3) as a tracker's: about three times the error along one axis."""
    sds = SIGMA_MM * rng.uniform(0.5, 1.5, (count, 1)) * np.array([0.5, 0.5, 1.6])
    turns = Rotation.random(count, rng=rng).as_matrix()
    covariances: FloatArray = turns @ (sds[:, :, None] ** 2 * np.eye(3)) @ turns.transpose(0, 2, 1)
    return covariances


def as_loose_as(
    points: FloatArray, moving: FloatArray, fixed: FloatArray, degrees: float
) -> tuple[FloatArray, FloatArray]:
    """Return the covariances so scaled that a rotation is uncertain by so many degrees."""
    low, high = 1e-8, 1e8
    while high / low > 1.0001:
        middle = np.sqrt(low * high)
        spread = planned_pose(points, (middle * moving, middle * fixed)).covariance
        low, high = (low, middle) if rotation_sd_deg(spread) > degrees else (middle, high)
    return low * moving, low * fixed


def simulated_tre(
    rng: np.random.Generator,
    markers: FloatArray,
    targets: FloatArray,
    errors: tuple[FloatArray, FloatArray],
    count: int,
    *,
    equal: bool = True,
) -> tuple[FloatArray, FloatArray]:
    """Return the RMS distance (T,) of targets from their images, and that which some of the fits state."""
    # A side without errors has no Cholesky root; the error itself is one then.
    roots = [np.linalg.cholesky(side) if side.any() else side for side in errors]
    fits = count if not equal else min(count, max(FITTED_POINTS // len(markers), 200))
    square, stated = np.zeros(len(targets)), np.zeros(len(targets))
    for here in parts(fits, len(markers)):
        moving, fixed = (
            markers + np.einsum("nij,bnj->bni", root, rng.normal(size=(here, *markers.shape))) for root in roots
        )
        batch = register_batch(moving, fixed, errors)
        assert batch.covariances is not None
        off = displaced(batch.transforms[:, :3, :3], batch.transforms[:, :3, 3], targets)
        arms = point_jacobian(targets + off)
        stated += np.einsum("btij,bjk,btik->t", arms, batch.covariances, arms)
        square += (off**2).sum(axis=(0, 2))
    if equal:
        sigmas = tuple(float(np.sqrt(side[0, 0, 0])) for side in errors)
        square = np.zeros(len(targets))
        for here in parts(count, 3):
            square += (displaced(*plain_fits(rng, markers, sigmas, here), targets) ** 2).sum(axis=(0, 2))
        return np.sqrt(square / count), np.sqrt(stated / fits)
    return np.sqrt(square / fits), np.sqrt(stated / fits)


def parts(count: int, points: int) -> list[int]:
    """Return ``count`` in parts that are handled at once."""
    size = max(CHUNK_POINTS // points, 1)
    return [min(size, count - start) for start in range(0, count, size)]


def displaced(turn: FloatArray, shift: FloatArray, targets: FloatArray) -> FloatArray:
    """Return how far (B, T, 3) motions bring targets (T, 3)."""
    return np.asarray(np.einsum("bij,tj->bti", turn, targets) + shift[:, None] - targets)


def plain_fits(
    rng: np.random.Generator, points: FloatArray, sigmas: tuple[float, ...], count: int
) -> tuple[FloatArray, FloatArray]:
    """Return rotations (B, 3, 3) and shifts (B, 3) of Kabsch fits to points (N, 3) read twice with normal errors.

    A fit depends on its readings by their centroids and cross-covariance only, so these are drawn: of the errors' N - 1
    centered dimensions three meet the points, the rest each other (Bartlett's decomposition).
    """
    moving, fixed = sigmas
    center = points.mean(axis=0)
    _, s, vt = np.linalg.svd(points - center, full_matrices=False)
    own = (vt.T * s)[:, : len(points) - 1]  # the points in their own dimensions, as columns
    a, b = (sigma * rng.normal(size=(count, *own.shape)) for sigma in (moving, fixed))
    cross = (own + b) @ (own + a).transpose(0, 2, 1)
    rest = max(len(points) - 4, 0)
    if rest >= 3:
        lower = np.tril(rng.normal(size=(count, 3, 3)), -1)
        for k in range(3):
            lower[:, k, k] = np.sqrt(rng.chisquare(rest - k, count))
        cross += moving * fixed * rng.normal(size=(count, 3, 3)) @ lower.transpose(0, 2, 1)
    elif rest > 0:
        a, b = (rng.normal(size=(count, 3, rest)) for _ in range(2))
        cross += moving * fixed * b @ a.transpose(0, 2, 1)
    left, _, right = np.linalg.svd(cross)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    turn = left @ right
    from_center, to_center = (
        center + sigma / np.sqrt(len(points)) * rng.normal(size=(count, 3)) for sigma in (moving, fixed)
    )
    return turn, to_center - np.einsum("bij,bj->bi", turn, from_center)


if __name__ == "__main__":
    main()
