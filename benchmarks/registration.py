"""Predicted target error against Monte Carlo, registrations a second, and pivot calibration, with a peer.

    python -m benchmarks.registration [--layouts N] [--trials N] [--pivot POSES.csv]

The peer's `compute_tre_from_fle` knows no anisotropic errors; release 0.8.3 takes the rows of the matrix of
principal axes where the axes are its columns, hence its errors. POSES.csv holds one 4 x 4 pose a row in its last
16 columns (row by row, tracker from tool, mm) below a header; plain least squares is the peer there.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan.geometry import FloatArray
from ronnaplan.registration import predict_tre, register_batch, register_points
from ronnaplan.report.tables import align

SIGMA_MM = 0.35


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--layouts", type=int, default=10, help="random layouts a number of markers")
    parser.add_argument("--trials", type=int, default=20_000, help="Monte Carlo trials a layout")
    parser.add_argument("--pivot", type=Path, metavar="POSES.csv")
    arguments = parser.parse_args()
    print(tre_table(arguments.layouts, arguments.trials))
    print()
    print(speed_table())
    if arguments.pivot:
        print()
        print(pivot_table(arguments.pivot))


def tre_table(layouts: int, trials: int) -> str:
    """Largest departure of the predicted from the simulated RMS TRE, in percent."""
    from sksurgerycore.algorithms.errors import compute_tre_from_fle

    rng = np.random.default_rng(1)
    rows = [["markers", "isotropic: ronnaplan", "scikit-surgerycore", "anisotropic: ronnaplan", ""]]
    for count in range(3, 13):
        worst = np.zeros(3)
        for _ in range(layouts):
            markers, target = random_layout(rng, count)
            equal = np.tile(SIGMA_MM**2 * np.eye(3), (count, 1, 1))
            observed = simulated_tre(rng, markers, target, equal, trials, stated=False)
            own = np.sqrt(np.trace(predict_tre(markers, equal, target)[0]))
            peer = np.sqrt(compute_tre_from_fle(markers, 3 * SIGMA_MM**2, target))
            unequal = random_covariances(rng, count)
            other = simulated_tre(rng, markers, target, unequal, trials, stated=True)
            predicted = np.sqrt(np.trace(predict_tre(markers, unequal, target)[0]))
            off = np.abs([own / observed - 1, peer / observed - 1, predicted / other - 1])
            worst = np.maximum(worst, 100 * off)
        rows.append([str(count), *(f"{value:.1f} %" for value in worst), ""])
    title = f"Largest error of the predicted RMS TRE over {layouts} layouts ({trials} Monte Carlo trials each)"
    return f"{title}\n{align(rows)}"


def random_layout(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """Return markers (count, 3), not nearly on one line, and a target (1, 3) in a head-sized ball."""
    while True:
        places = rng.normal(size=(count + 1, 3))
        places *= (90 * rng.random(count + 1) ** (1 / 3) / np.linalg.norm(places, axis=1))[:, None]
        markers = places[:count]
        if np.linalg.svd(markers - markers.mean(axis=0), compute_uv=False)[1] > 25:
            return markers, places[count:]


def random_covariances(rng: np.random.Generator, count: int) -> FloatArray:
    """Return covariances (count, 3, 3) as a tracker's: about three times the error along one axis."""
    sds = SIGMA_MM * rng.uniform(0.5, 1.5, (count, 1)) * np.array([0.5, 0.5, 1.6])
    turns = Rotation.random(count, rng=rng).as_matrix()
    covariances: FloatArray = turns @ (sds[:, :, None] ** 2 * np.eye(3)) @ turns.transpose(0, 2, 1)
    return covariances


def simulated_tre(
    rng: np.random.Generator,
    markers: FloatArray,
    target: FloatArray,
    covariances: FloatArray,
    trials: int,
    *,
    stated: bool,
) -> float:
    """Return the RMS distance between the target and its image over ``trials`` registrations."""
    noise = np.einsum("nij,bnj->bni", np.linalg.cholesky(covariances), rng.normal(size=(trials, *markers.shape)))
    moving = np.broadcast_to(markers, noise.shape)
    zero = np.zeros((3, 3))
    found = register_batch(moving, moving + noise, (zero, covariances) if stated else None).transforms
    error = target @ found[:, :3, :3].swapaxes(1, 2) + found[:, None, :3, 3] - target
    return float(np.sqrt((error**2).sum(axis=-1).mean()))


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


def pivot_table(path: Path) -> str:
    """Pivot calibration of a recorded tool, slips included, with the scatter of a block bootstrap."""
    from ronnaplan.robot.pivot import calibrate_pivot
    from ronnaplan.tracking import read_recording

    poses = read_recording(path).poses("tool")
    own = calibrate_pivot(poses)
    design = np.concatenate([poses[:, :3, :3], np.tile(-np.eye(3), (len(poses), 1, 1))], axis=2).reshape(-1, 6)
    plain = np.linalg.lstsq(design, -poses[:, :3, 3].ravel(), rcond=None)[0]
    plain_rms = np.sqrt(((design @ plain + poses[:, :3, 3].ravel()) ** 2).sum() / len(poses))
    rng = np.random.default_rng(3)
    block, tips = len(poses) // 20, []
    for _ in range(60):
        starts = rng.integers(0, len(poses) - block + 1, len(poses) // block + 1)
        tips.append(calibrate_pivot(poses[(starts[:, None] + np.arange(block)).ravel()[: len(poses)]]).tip_mm)
    rows = [["", "x", "y", "z", "RMS kept, mm", ""]]
    rows.append(["least squares, all poses", *numbers(plain[:3]), f"{plain_rms:.2f}", ""])
    rows.append([f"ronnaplan ({own.slipped.sum()} poses left out)", *numbers(own.tip_mm), f"{own.rms_mm:.2f}", ""])
    rows.append(["  its standard error", *numbers(np.sqrt(np.diag(own.tip_covariance_mm2))), "", ""])
    rows.append([f"  block bootstrap ({block} poses)", *numbers(np.std(tips, axis=0)), "", ""])
    slips = ", ".join(f"{first}-{last}" for first, last in own.slips)
    return f"{align(rows)}\nslipped poses: {slips}"


def numbers(values: FloatArray) -> list[str]:
    """Format mm."""
    return [f"{value:.2f}" for value in values]


if __name__ == "__main__":
    main()
