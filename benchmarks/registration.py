"""What is said to have moved, markers doubted without cause, and registrations a second, with a peer.

    python -m benchmarks.registration drift|doubts|speed [--cases N] [--seed N]

`python -m benchmarks.tre` compares predicted target errors with Monte Carlo.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import fdtrc, gammaincc

from benchmarks.tre import SIGMA_MM, random_covariances, random_layout
from ronnaplan.geometry import FloatArray, Frame, Points, unit
from ronnaplan.registration import (
    Drift,
    DriftStatus,
    check_drift,
    doubted_marker,
    register_batch,
    register_points,
)
from ronnaplan.registration.covariances import combined_covariances
from ronnaplan.report.tables import align
from ronnaplan.rigid import COLLINEARITY_TOLERANCE, fit_closed_form, fit_likelihood
from ronnaplan.sigmas import MISFIT_PROBABILITY, SIGMA_OTS_MM
from ronnaplan.transforms import transform_points

READING_MM = SIGMA_OTS_MM
OTS = Frame("OTS")
LAYOUTS = {
    "ball": (50.0, 50.0, 50.0),
    "plate": (50.0, 50.0, 2.0),
    "row": (50.0, 4.0, 4.0),
    "thin row": (50.0, 0.2, 0.2),
}
"""Standard deviations (mm) of markers along three axes."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("drift", "doubts", "speed"))
    parser.add_argument("--cases", type=int, default=500, help="movements, or registrations, a row")
    parser.add_argument("--seed", type=int, default=3)
    arguments = parser.parse_args()
    if arguments.what == "speed":
        print(speed_table())
    else:
        table = {"drift": drift_table, "doubts": doubts_table}[arguments.what]
        print(table(arguments.cases, arguments.seed))


def drift_table(cases: int, seed: int) -> str:
    """What `check_drift` says of a loose marker, on a head that rests or moved, and of a moved head."""
    rows = [["markers", "what moved", "so said", "named alone", "in a list", "another alone", "called still", ""]]
    for count in range(4, 9):
        said = {
            kind: np.zeros(5) for kind in ("one by 2 mm", "head, and one by 2 mm", "head, and one by 5 mm", "head")
        }
        rng = np.random.default_rng([seed, count])
        for _ in range(cases):
            for kind, counted in said.items():
                found = drift_of(
                    rng, count, head="head" in kind, loose_mm=float(kind[-4]) if "mm" in kind else 0.0
                )
                right = DriftStatus.MARKER_MOVED if "mm" in kind else DriftStatus.PATIENT_MOVED
                counted += [
                    found.status is right,
                    found.loose == ("0",),
                    "0" in found.loose and len(found.loose) > 1,
                    len(found.loose) == 1 and "0" not in found.loose,
                    found.status is DriftStatus.STILL,
                ]
        for kind, counted in said.items():
            rows.append([str(count), kind, *(f"{100 * part / cases:.1f} %" for part in counted), ""])
    return f"What is said to have moved ({cases} movements a row)\n{align(rows)}"


def drift_of(rng: np.random.Generator, count: int, *, head: bool, loose_mm: float) -> Drift:
    """Return what is said of markers read twice by 0.17 mm an axis, between which the head or marker 0 moved.

    The head moves by 2 or 20 mm and turns by 0, 1 or 5 degrees.
    """
    markers = random_layout(rng, count)[0]
    covariances = np.tile(READING_MM**2 * np.eye(3), (count, 1, 1))
    first, second = (markers + READING_MM * rng.normal(size=markers.shape) for _ in range(2))
    second[0] += loose_mm * unit(rng.normal(size=3))
    if head:
        turn = Rotation.from_rotvec(np.radians(rng.choice([0.0, 1.0, 5.0])) * unit(rng.normal(size=3)))
        second = turn.apply(second) + rng.choice([2.0, 20.0]) * unit(rng.normal(size=3))
    labels = tuple(map(str, range(count)))
    return check_drift(Points(first, covariances, labels, OTS), Points(second, covariances, labels, OTS))


def doubts_table(cases: int, seed: int) -> str:
    """How many registrations of good markers doubt one; 1 in 1,000 is stated."""
    rows = [["markers", *(f"{name}, errors {known}" for name in LAYOUTS for known in ("stated", "not")), ""]]
    for count in (4, 5, 6, 8):
        cells = []
        for name, sizes in LAYOUTS.items():
            rng = np.random.default_rng([seed, count, len(name)])
            doubted = [
                doubted_shares(rng, count, np.array(sizes), cases, stated=stated) for stated in (True, False)
            ]
            cells += [f"{1000 * share:.2f}" for share in doubted]
        rows.append([str(count), *cells, ""])
        print(rows[-1], flush=True)
    return f"Registrations of good markers that doubt one, per 1,000 ({cases} layouts a cell)\n{align(rows)}"


def doubted_shares(rng: np.random.Generator, count: int, sizes: FloatArray, cases: int, *, stated: bool) -> float:
    """Return the share of random layouts of good markers of which one is doubted.

    It is what `doubted_marker` says of each, for all at once: by how much the misfit falls without a marker. The first
    are asked of `doubted_marker` itself.
    """
    markers = rng.normal(size=(cases, count, 3)) * sizes
    errors = random_covariances(rng, count) if stated else np.tile(0.5 * SIGMA_MM**2 * np.eye(3), (count, 1, 1))
    root = np.linalg.cholesky(errors)
    moving, fixed = (markers + np.einsum("nij,bnj->bni", root, rng.normal(size=markers.shape)) for _ in range(2))
    accepted = off_line(moving) & off_line(fixed)
    moving, fixed = moving[accepted], fixed[accepted]
    both = (errors, errors) if stated else None
    whole = misfit(moving, fixed, both)
    freedom = 3 * (count - 1) - 6
    least = np.ones(len(moving))
    for left in range(count):
        keep = np.arange(count) != left
        rest = misfit(moving[:, keep], fixed[:, keep], (errors[keep], errors[keep]) if stated else None)
        excess = np.maximum(whole - rest, 0)
        chance = gammaincc(1.5, excess / 2) if stated else fdtrc(3, freedom, excess / 3 / (rest / freedom))
        least = np.where(off_line(moving[:, keep]), np.minimum(least, chance), least)
    doubted = least < MISFIT_PROBABILITY / count
    for k in [*range(20), *np.flatnonzero(doubted)[:20]]:
        assert doubted[k] == (doubted_marker(register_points(moving[k], fixed[k], both)) is not None)
    return float(doubted.mean())


def off_line(points: FloatArray) -> NDArray[np.bool_]:
    """Tell of each set of points (B, N, 3) whether it can be registered."""
    spread = np.linalg.svd(points - points.mean(axis=1, keepdims=True), compute_uv=False)
    return np.asarray(spread[:, 1] > COLLINEARITY_TOLERANCE * spread[:, 0])


def misfit(moving: FloatArray, fixed: FloatArray, errors: tuple[FloatArray, FloatArray] | None) -> FloatArray:
    """Return the chi-square (B,) of the best fit of each pair of point sets, of unit variance where none is stated."""
    transforms = fit_closed_form(moving, fixed) if errors is None else fit_likelihood(moving, fixed, *errors)[0]
    residual = fixed - transform_points(transforms, moving)
    combined = np.eye(3) if errors is None else combined_covariances(transforms, *errors)
    return np.asarray((residual * np.linalg.solve(combined, residual[..., None])[..., 0]).sum(axis=(1, 2)))


def speed_table() -> str:
    """Registrations a second of eight markers: one by one, and in a batch."""
    from sksurgerycore.algorithms.procrustes import orthogonal_procrustes

    rng = np.random.default_rng(2)
    markers = random_layout(rng, 8)[0]
    covariances = random_covariances(rng, 8)
    fixed = markers + rng.normal(size=(20_000, 8, 3)) * SIGMA_MM
    moving = np.broadcast_to(markers, fixed.shape)
    some = fixed[:300]
    rates = {
        "scikit-surgerycore, one by one": rate(300, lambda: [orthogonal_procrustes(f, markers) for f in some]),
        "ronnaplan, one by one, with covariance": rate(300, lambda: [register_points(markers, f) for f in some]),
        "ronnaplan, a batch, closed form": rate(20_000, lambda: register_batch(moving, fixed)),
        "ronnaplan, a batch, maximum likelihood with covariance": rate(
            20_000, lambda: register_batch(moving, fixed, (covariances, covariances))
        ),
    }
    first = next(iter(rates.values()))
    rows = [["eight markers", "a CPU second", "ratio", ""]]
    rows += [[name, f"{value:,.0f}", f"{value / first:.1f}", ""] for name, value in rates.items()]
    return align(rows)


def rate(count: int, work: Callable[[], object]) -> float:
    """Return how many of ``count`` pieces of ``work`` are done in a CPU second, best of three runs."""
    best = np.inf
    for _ in range(3):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return count / best


if __name__ == "__main__":
    main()
