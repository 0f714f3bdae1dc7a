"""Localization against its goals and its peers, on physically simulated patients.

    python -m benchmarks.localization accuracy [--markers N] [--first SEED] [--cache FOLDER] [--condition NAME]
    python -m benchmarks.localization rendered [--markers N] [--first SEED] [--condition NAME]
    python -m benchmarks.localization protocols [--markers N] [--first SEED] [--condition NAME]
    python -m benchmarks.localization peers [--slices-mm T]

``accuracy`` scans whole patients with the projection-domain scanner until each condition has its markers, and prints
recall, false positives, error beside that of a plain fit that is told where to look, and how honest the stated
uncertainty is (mean squared normalized error per degree of freedom, share within the 95 % ellipsoid). ``rendered`` does
the same with many markers from the fast renderer, ``protocols`` with scans as hospitals make them: kernels, profiles,
denoising, cone beams, and headers as they are. Seeds below `FIRST_UNSEEN` were used for tuning and are refused.
``peers`` runs other tools' recipes on one rendered head.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.cases import (
    CONDITIONS,
    PROTOCOLS,
    Case,
    Condition,
    protocol_scan,
    surroundings,
    volume,
    whole_scan,
)
from benchmarks.ideal import ideal_center
from benchmarks.peers import PEERS
from phantoms.errors import PhantomError
from phantoms.fast import render
from phantoms.library import demo_head
from phantoms.stack import axial_stack
from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import localize
from ronnaplan.report.tables import align

FIRST_UNSEEN = {"accuracy": 15400, "rendered": 26000, "protocols": 31000}
"""Patients with lower seeds were looked at while tuning, scanned or rendered."""

BARE_SCANS = 5
"""Heads without markers that are searched, one for each kind of marker."""

FOUND_WITHIN_MM = 1.0
CHI2_95 = 7.815
"""95 % quantile of chi-square with three degrees of freedom."""

HEADING = (
    *("condition", "patients", "markers", "missed", "false", "mean um", "goal", "worst um", "goal"),
    *("ideal um", "nees", "in 95 %", "eff."),
)


@dataclass
class Score:
    """What a condition's scans add up to."""

    patients: int = 0
    missed: int = 0
    false: int = 0
    errors_mm: list[float] = field(default_factory=list)
    ideal_mm: list[float] = field(default_factory=list)
    """Errors of a plain fit that is told where to look, on the same markers."""
    normalized: list[float] = field(default_factory=list)
    efficiencies: list[float] = field(default_factory=list)

    @property
    def markers(self) -> int:
        """Markers that should have been found so far."""
        return len(self.errors_mm) + self.missed

    def add(self, case: Case) -> None:
        """Localize one scan and compare with its truth; a marker cut by the scan's edge may be found or not."""
        found = localize(case.volume, diameter_mm=case.diameter_mm)
        known = np.concatenate([case.truth_mm, case.cut_mm])
        self.false += sum(_nearest(known, center) > FOUND_WITHIN_MM for center in found.centers)
        for center_mm in case.truth_mm:
            own = [one for one in found.fiducials if np.linalg.norm(one.center_mm - center_mm) <= FOUND_WITHIN_MM]
            if not own:
                self.missed += 1
                continue
            error = own[0].center_mm - center_mm
            self.errors_mm.append(float(np.linalg.norm(error)))
            ideal = ideal_center(case.volume, center_mm, case.diameter_mm)
            self.ideal_mm.append(float(np.linalg.norm(ideal - center_mm)))
            self.normalized.append(float(error @ np.linalg.solve(own[0].covariance_mm2, error)))
            self.efficiencies.append(own[0].efficiency)

    def row(self, condition: Condition) -> list[str]:
        """One line of the table."""
        counts = [condition.name, *map(str, (self.patients, self.markers, self.missed, self.false))]
        if not self.errors_mm:
            return [*counts, *["-"] * 8]
        normalized = np.array(self.normalized)
        return [
            *counts,
            f"{1e3 * np.mean(self.errors_mm):.1f}",
            f"{1e3 * condition.mean_mm:.0f}",
            f"{1e3 * np.max(self.errors_mm):.1f}",
            f"{1e3 * condition.worst_mm:.0f}",
            f"{1e3 * np.mean(self.ideal_mm):.1f}",
            f"{normalized.mean() / 3:.2f}",
            f"{np.mean(normalized <= CHI2_95):.0%}",
            f"{np.median(self.efficiencies):.1g}",
        ]


Scans = Callable[[Condition, int], Iterator[Case]]
"""Yields the scans of a condition's patient, by its number."""


def accuracy(conditions: Sequence[Condition], scans: Scans, markers: int, names: list[str]) -> None:
    """Print the table of the goals, each condition with at least so many ``markers``."""
    rows = [list(HEADING)]
    for condition in conditions:
        if names and condition.name not in names:
            continue
        score = Score()
        for number in itertools.count():
            if score.markers >= markers or (condition.markers == 0 and number == BARE_SCANS):
                break
            try:
                for case in scans(condition, number):
                    score.add(case)
            except PhantomError:  # drawn with a decoy inside the infusion tube: the next patient takes his place
                continue
            score.patients += 1
        rows.append(score.row(condition))
        print("  ".join(rows[-1]), file=sys.stderr, flush=True)
    print(align(rows))


def peers(slices_mm: float) -> None:
    """Print error, recall, false positives and time of other tools' recipes on the demo head, and of ours."""
    scene = demo_head()
    stack = axial_stack(start_mm=-62.0, stop_mm=117.0, spacing_mm=slices_mm, matrix=384, field_of_view_mm=250.0)
    images = render(scene, stack, noise_hu=15.0, seed=11)
    ct = volume(stack, images, slices_mm)
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
    return float(np.linalg.norm(truth_mm - center_mm, axis=1).min(initial=np.inf))


def main() -> None:
    """Run one of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    for name, markers in (("accuracy", 40), ("rendered", 500), ("protocols", 40)):
        study = verbs.add_parser(name)
        study.add_argument("--markers", type=int, default=markers)
        study.add_argument("--first", type=int, default=FIRST_UNSEEN[name], metavar="SEED")
        study.add_argument("--condition", action="append", default=[])
        if name == "accuracy":
            study.add_argument("--cache", type=Path)
    verbs.add_parser("peers").add_argument("--slices-mm", type=float, default=1.0)
    arguments = parser.parse_args()
    if arguments.verb == "peers":
        peers(arguments.slices_mm)
    elif arguments.first < FIRST_UNSEEN[arguments.verb]:
        parser.error(f"the seeds below {FIRST_UNSEEN[arguments.verb]} were used for tuning; choose others")
    else:
        conditions = PROTOCOLS if arguments.verb == "protocols" else CONDITIONS
        accuracy(conditions, _scans(arguments), arguments.markers, arguments.condition)


def _scans(arguments: argparse.Namespace) -> Scans:
    if arguments.verb == "rendered":
        return lambda condition, number: surroundings(condition, arguments.first, number)
    if arguments.verb == "protocols":
        return lambda condition, number: protocol_scan(condition, arguments.first, number)
    if arguments.cache:
        arguments.cache.mkdir(parents=True, exist_ok=True)
    return lambda condition, number: iter([whole_scan(condition, arguments.first, number, arguments.cache)])


if __name__ == "__main__":
    main()
