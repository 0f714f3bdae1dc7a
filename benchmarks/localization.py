"""Localization against its goals and its peers, on physically simulated patients.

    python -m benchmarks.localization accuracy [--patients N] [--first SEED] [--cache FOLDER]
    python -m benchmarks.localization peers [--slices-mm T]

``accuracy`` prints, for each condition, markers, recall, false positives, error, and how honest the stated
uncertainty is (mean squared normalized error per degree of freedom, share within the 95 % ellipsoid). Seeds 100
to 102 were used for tuning and are refused. ``peers`` runs other tools' recipes on one rendered head.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.cases import CONDITIONS, Case, Condition, cases
from benchmarks.peers import PEERS
from phantoms.fast import render
from phantoms.library import demo_head
from phantoms.stack import axial_stack
from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import localize
from ronnaplan.report.tables import align

TUNING_SEEDS = range(100, 103)
FOUND_WITHIN_MM = 1.0
CHI2_95 = 7.815
"""95 % quantile of chi-square with three degrees of freedom."""


@dataclass
class Score:
    """What a condition's markers add up to."""

    errors_mm: list[float] = field(default_factory=list)
    normalized: list[float] = field(default_factory=list)
    efficiencies: list[float] = field(default_factory=list)
    missed: int = 0
    false: int = 0

    def add(self, case: Case) -> None:
        """Localize one case and compare with its truth."""
        found = localize(case.volume, diameter_mm=case.diameter_mm)
        self.false += sum(_nearest(case.truth_mm, center) > FOUND_WITHIN_MM for center in found.centers)
        own = [one for one in found.fiducials if _nearest(case.truth_mm[:1], one.center_mm) <= FOUND_WITHIN_MM]
        if not own:
            self.missed += 1
            return
        error = own[0].center_mm - case.truth_mm[0]
        self.errors_mm.append(float(np.linalg.norm(error)))
        self.normalized.append(float(error @ np.linalg.solve(own[0].covariance_mm2, error)))
        self.efficiencies.append(own[0].efficiency)

    def row(self, condition: Condition) -> list[str]:
        """One line of the table."""
        count = len(self.errors_mm) + self.missed
        if not self.errors_mm:
            return [condition.name, str(count), str(self.missed), str(self.false), *["-"] * 7]
        normalized = np.array(self.normalized)
        return [
            condition.name,
            str(count),
            str(self.missed),
            str(self.false),
            f"{1e3 * np.mean(self.errors_mm):.1f}",
            f"{1e3 * condition.mean_mm:.0f}",
            f"{1e3 * np.max(self.errors_mm):.1f}",
            f"{1e3 * condition.worst_mm:.0f}",
            f"{normalized.mean() / 3:.2f}",
            f"{np.mean(normalized <= CHI2_95):.0%}",
            f"{np.median(self.efficiencies):.2f}",
        ]


def accuracy(seeds: Iterable[int], cache: Path | None, names: list[str]) -> None:
    """Print the table of the goals."""
    heading = [
        "condition",
        "n",
        "missed",
        "false",
        "mean um",
        "goal",
        "worst um",
        "goal",
        "nees",
        "in 95 %",
        "eff.",
    ]
    rows = [heading]
    for condition in CONDITIONS:
        if names and condition.name not in names:
            continue
        score = Score()
        for seed in seeds:
            for case in cases(condition, seed, cache):
                score.add(case)
        rows.append(score.row(condition))
    print(align(rows))


def peers(slices_mm: float) -> None:
    """Print error, recall, false positives and time of other tools' recipes on the demo head, and of ours."""
    scene = demo_head()
    stack = axial_stack(start_mm=-62.0, stop_mm=117.0, spacing_mm=slices_mm, matrix=384, field_of_view_mm=250.0)
    images = render(scene, stack, noise_hu=15.0, seed=11)
    from benchmarks.cases import volume

    ct = volume(stack, images)
    truth = np.array([marker.center_mm for marker in scene.markers])
    localize(ct, diameter_mm=11.5)  # compile first
    methods: dict[str, Callable[[CTVolume, float], FloatArray]] = {
        "ronnaplan": lambda ct, diameter: localize(ct, diameter_mm=diameter).centers,
        **PEERS,
    }
    rows = [["method", "found", "false", "mean um", "worst um", "s"]]
    for name, method in methods.items():
        start = time.perf_counter()
        centers = method(ct, 11.5)
        seconds = time.perf_counter() - start
        rows.append([name, *_compare(centers, truth), f"{seconds:.2f}"])
    print(align(rows))


def _compare(centers: FloatArray, truth: FloatArray) -> list[str]:
    """Found, false, mean and worst error in micrometres; a place within 3 mm of a marker counts as that marker."""
    if len(centers) == 0:
        return [f"0/{len(truth)}", "0", "-", "-"]
    distances = np.linalg.norm(truth[:, np.newaxis] - centers, axis=-1)
    errors = distances.min(axis=1)
    found = errors < 3.0
    false = int(np.sum(distances.min(axis=0) >= 3.0))
    if not found.any():
        return [f"0/{len(truth)}", str(false), "-", "-"]
    mean, worst = 1e3 * errors[found].mean(), 1e3 * errors[found].max()
    return [f"{found.sum()}/{len(truth)}", str(false), f"{mean:.1f}", f"{worst:.1f}"]


def _nearest(truth_mm: FloatArray, center_mm: FloatArray) -> float:
    return float(np.linalg.norm(truth_mm - center_mm, axis=1).min())


def main() -> None:
    """Run one of the two."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    goals = verbs.add_parser("accuracy")
    goals.add_argument("--patients", type=int, default=5)
    goals.add_argument("--first", type=int, default=5000, metavar="SEED")
    goals.add_argument("--cache", type=Path)
    goals.add_argument("--condition", action="append", default=[])
    others = verbs.add_parser("peers")
    others.add_argument("--slices-mm", type=float, default=1.0)
    arguments = parser.parse_args()
    if arguments.verb == "peers":
        peers(arguments.slices_mm)
        return
    seeds = range(arguments.first, arguments.first + arguments.patients)
    if set(seeds) & set(TUNING_SEEDS):
        parser.error("the seeds 100 to 102 were used for tuning; choose others")
    if arguments.cache:
        arguments.cache.mkdir(parents=True, exist_ok=True)
    accuracy(seeds, arguments.cache, arguments.condition)


if __name__ == "__main__":
    main()
