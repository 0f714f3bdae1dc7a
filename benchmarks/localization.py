"""Localization against its goals and its peers, on physically simulated patients.

    python -m benchmarks.localization accuracy [--markers N] [--first SEED] [--cache FOLDER] [--condition NAME]
    python -m benchmarks.localization rendered [--markers N] [--first SEED] [--condition NAME]
    python -m benchmarks.localization protocols [--markers N] [--first SEED] [--cache FOLDER] [--condition NAME]
    python -m benchmarks.localization kept FOLDER [--condition NAME]
    python -m benchmarks.localization peers [--slices-mm T]

``accuracy`` scans whole patients with the projection-domain scanner until each condition has its markers, and prints
recall, false positives, error beside that of a plain fit that is told where to look, and how honest the stated
uncertainty is (mean squared normalized error per degree of freedom, share within the 95 % ellipsoid). ``rendered`` does
the same with many markers from the fast renderer, ``protocols`` with scans as hospitals make them: kernels, profiles,
denoising, helices, cone beams, heads that jump, and headers as they are; ``kept`` judges the scans that ``protocols``
has kept in a folder. Seeds below `FIRST_UNSEEN` were used for tuning and are refused.
``--pull-mm`` judges the stated errors as if every center were pulled so far along its post, as screws do elsewhere.
``peers`` runs other tools' recipes on one rendered head.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.cases import (
    CONDITIONS,
    PROTOCOLS,
    WHOLE,
    Case,
    Condition,
    kept_cases,
    kept_scans,
    protocol_scan,
    surroundings,
    volume,
    whole_scan,
)
from benchmarks.peers import PEERS
from benchmarks.scores import HEADING, Score
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

STUDIED = {"accuracy": WHOLE, "rendered": CONDITIONS, "protocols": PROTOCOLS}
"""What each study scans."""

BARE_SCANS = 5
"""Heads without markers that are searched, one for each kind of marker."""

Scans = Callable[[Condition, int], Iterable[Case]]
"""Yields the scans of a condition's patient, by its number."""


def accuracy(
    conditions: Sequence[Condition], scans: Scans, markers: int, names: list[str], pull_mm: float = 0.0
) -> None:
    """Print the table of the goals, each condition with at least so many ``markers``."""
    rows = [list(HEADING)]
    for condition in conditions:
        if names and condition.name not in names:
            continue
        score = Score(pull_mm)
        for number in itertools.count():
            if score.markers >= markers or (condition.markers == 0 and number == BARE_SCANS):
                break
            try:
                score.add(list(scans(condition, number)))
            except PhantomError:  # drawn with a decoy inside the infusion tube: the next patient takes his place
                continue
        rows.append(score.row(condition))
        print("  ".join(rows[-1]), file=sys.stderr, flush=True)
    print(align(rows))


def kept(folder: Path, names: list[str], pull_mm: float) -> None:
    """Print the same table of the scans kept in ``folder``, for each condition that has any."""
    rows = [list(HEADING)]
    for condition in PROTOCOLS:
        files = kept_scans(condition, folder)
        if not files or (names and condition.name not in names):
            continue
        score = Score(pull_mm)
        for file in files:
            score.add(kept_cases(file))
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


def main() -> None:
    """Run one of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    again = verbs.add_parser("kept")
    again.add_argument("folder", type=Path)
    studies: dict[argparse.ArgumentParser, tuple[Condition, ...]] = {again: PROTOCOLS}
    for name, markers in (("accuracy", 40), ("rendered", 500), ("protocols", 40)):
        study = verbs.add_parser(name)
        studies[study] = STUDIED[name]
        study.add_argument("--markers", type=int, default=markers)
        study.add_argument("--first", type=int, default=FIRST_UNSEEN[name], metavar="SEED")
        if name != "rendered":
            study.add_argument("--cache", type=Path, help="keep the scans there, and take those kept")
    for study, of_study in studies.items():
        names = [condition.name for condition in of_study]
        study.add_argument("--condition", action="append", default=[], choices=names, metavar="NAME")
        study.add_argument(
            "--pull-mm", type=float, default=0.0, help="error along posts that is added when judging"
        )
    verbs.add_parser("peers").add_argument("--slices-mm", type=float, default=1.0)
    arguments = parser.parse_args()
    if arguments.verb == "peers":
        peers(arguments.slices_mm)
    elif arguments.verb == "kept":
        kept(arguments.folder, arguments.condition, arguments.pull_mm)
    elif arguments.first < FIRST_UNSEEN[arguments.verb]:
        parser.error(f"the seeds below {FIRST_UNSEEN[arguments.verb]} were used for tuning; choose others")
    else:
        accuracy(
            STUDIED[arguments.verb], _scans(arguments), arguments.markers, arguments.condition, arguments.pull_mm
        )


def _scans(arguments: argparse.Namespace) -> Scans:
    if arguments.verb == "rendered":
        return lambda condition, number: surroundings(condition, arguments.first, number)
    if arguments.cache:
        arguments.cache.mkdir(parents=True, exist_ok=True)
    if arguments.verb == "protocols":
        return lambda condition, number: protocol_scan(condition, arguments.first, number, arguments.cache)
    return lambda condition, number: [whole_scan(condition, arguments.first, number, arguments.cache)]


if __name__ == "__main__":
    main()
