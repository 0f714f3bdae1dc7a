"""Measure SEED_SUCCESS of ronnaplan/correspondence/poses.py: what share of the triangles in a body lead to its pose.

    python scripts/fit_seed_success.py [--seeds N]

A body of 40 markers lies among 160 outliers of a 300 mm field.  Only triangles of the body are drawn; a triangle
succeeds when its pose pairs most of the body.  The share is over the probability that enough trial points are of
the body, which the matcher counts apart.
"""

from __future__ import annotations

import argparse

import numpy as np

from ronnaplan.correspondence import poses
from ronnaplan.correspondence.evidence import filled_volume
from ronnaplan.correspondence.inputs import ErrorModel
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.seeds import poses_of_seeds
from ronnaplan.correspondence.told import Told
from ronnaplan.correspondence.trials import MOST_TRIALS
from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.studies.scenes import uniform_in_ball

BODY, OUTLIERS, FIELD_MM = 40, 160, 300.0


def bodies(rng: np.random.Generator) -> dict[str, FloatArray]:
    """Return a body of each shape, (40, 3) in mm."""
    ball = uniform_in_ball(rng, (BODY,), 90.0)
    shell = 90.0 * ball / np.linalg.norm(ball, axis=1, keepdims=True) * [1.0, 1.2, 1.0]
    return {
        "ball of 90 mm": ball,
        "ball of 30 mm": ball / 3.0,
        "head": shell * [1.0, 1.0, np.nan_to_num(1.0)] + 0.0,
        "plate": ball * [1.0, 1.0, 0.05],
        "rod": ball * [0.2, 0.2, 1.0],
    }


def success(rng: np.random.Generator, body: FloatArray, seeds: int, every: bool) -> float:
    """Return the share of ``seeds`` triangles within a body that lead to its pose."""
    ct, ots = (
        np.vstack((body + s * rng.standard_normal(body.shape), uniform_in_ball(rng, (OUTLIERS,), FIELD_MM)))
        for s in (SIGMA_CT_MM, SIGMA_OTS_MM)
    )
    count = len(ct)
    errors = [ErrorModel(np.full(count, s**2), None) for s in (SIGMA_CT_MM, SIGMA_OTS_MM)]
    known = np.zeros((0, 2), dtype=np.int64)
    problem = Problem(ct, ots, errors[0], errors[1], Told(), known, filled_volume(ct, ots), 60.0)
    search = poses.Search.of(problem, every)
    drawn = np.argsort(rng.random((seeds, BODY)), axis=1)[:, :3]
    trials = np.argsort(rng.random((seeds, count)), axis=1)[:, : MOST_TRIALS + 3]
    none = np.zeros((0, count), dtype=np.int64)
    matrices, hits, _, _ = poses_of_seeds(
        ct,
        ots,
        search.grid,
        drawn,
        trials,
        search.needed,
        (search.hit_chance, float(search.share(BODY))),
        search.table,
        problem.sigma_mm,
        search.sides_chi2,
        none,
        1e12,
    )
    right = 0
    for found, hit in zip(matrices, hits, strict=True):
        refined = poses.refine(search, found[hit > 0], max(search.needed_of_all[1], 1))
        right += any((pose.partner[:BODY] == np.arange(BODY)).mean() > 0.5 for pose in refined)
    passes = float(search.passes(np.array([float(BODY)]))[0])
    return right / seeds / passes


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2000, help="triangles a body")
    seeds = parser.parse_args().seeds
    for every, chi2 in enumerate(poses.SIDES_CHI2):
        for name, body in bodies(np.random.default_rng(5)).items():
            print(
                f"sides within {chi2:g}, {name}: {success(np.random.default_rng(6), body, seeds, bool(every)):.2f}"
            )


if __name__ == "__main__":
    main()
