"""Markers as they are: what lies on them, around or in them must be flagged, or be within the error that is stated.

    python -m benchmarks.coverings [--protocol NAME] [--markers N] [--first SEED] [--cache FOLDER] [--row NAME ...]

Patients are scanned by a protocol of `phantoms` (axial by default), each with markers of one of the rows. A marker is
flagged that carries `diameter`, `covered` or `motion_suspected`. *Silent* are those found that are neither flagged nor
within the stated 95 %: for each row their number, and the largest error of one of them.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks.cases import DECOYS_EACH, SEED_STEP, Case, kept_cases, scanned
from benchmarks.scores import CHI2_95, FOUND_WITHIN_MM, markers_of
from phantoms.errors import PhantomError
from phantoms.patients import random_patient
from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.moving import moved
from ronnaplan.report.tables import align

FIRST_UNSEEN = 53000
"""Patients with lower seeds were looked at while tuning."""

MARKERS_EACH = 20
HEADING = (
    *("markers", "found", "missed", "false", "mean um", "worst um", "flagged"),
    *("in 95 %", "or flagged", "silent", "worst um"),
)


@dataclass(frozen=True)
class Row:
    """A kind of marker, what lies on it, and as what it is looked for."""

    name: str
    kind: str = "post"
    covering: str = ""
    covered: float = 1.0
    """Share of the markers that have it."""
    is_as_made: bool = False
    touches: bool = False
    build: Build = SOLID
    shown_mm: float | None = None
    """Diameter of the ball that is looked for, where that is not the marker's."""


def _wrapped(name: str, thickness_mm: float) -> tuple[Row, Row]:
    return Row(name, covering=name), Row(f"{name}, asked for", covering=name, build=Build(thickness_mm))


ROWS = (
    Row("bare"),
    Row("as made", is_as_made=True),
    Row("bubble", covering="bubble"),
    *(Row(f"{name} on a third", covering=name, covered=1 / 3) for name in ("foil", "thin tape")),
    *(Row(name, covering=name) for name in ("thin film", "film", "thick film", "tape", "drape", "hair")),
    *(*_wrapped("gel", 2.0), *_wrapped("cloth", 1.5), *_wrapped("gauze", 4.0)),
    Row("gel, as the ball it shows", covering="gel", shown_mm=15.5),
    Row("cloth, as the ball it shows", covering="cloth", shown_mm=12.7),
    Row("anything, as made", covering="any", is_as_made=True),
    Row("touching", touches=True),
    Row("coated", "coated post"),
    Row("hollow plastic, asked for", "hollow plastic post", build=Build(-1.0)),
    Row("hollow glass, asked for", "hollow glass post", build=Build(-0.8)),
)


@dataclass
class Score:
    """What a row's scans add up to."""

    missed: int = 0
    false: int = 0
    errors_mm: list[float] = field(default_factory=list)
    within: list[bool] = field(default_factory=list)
    flagged: list[bool] = field(default_factory=list)

    def add(self, cases: list[Case], build: Build) -> None:
        """Localize one patient's markers and compare with their truth."""
        parts = markers_of(cases, build)
        found_all = [one for part in parts for one in part]
        has_moved = moved(Scan(cases[0].volume), found_all)
        doubts = iter(
            has or one.is_off_size or one.is_covered for has, one in zip(has_moved, found_all, strict=True)
        )
        for case, part in zip(cases, parts, strict=True):
            found = [(one, next(doubts)) for one in part]
            known = np.concatenate([case.truth_mm, case.cut_mm])
            apart = [np.linalg.norm(known - one.center_mm, axis=1).min(initial=np.inf) for one, _ in found]
            self.false += sum(bool(each > FOUND_WITHIN_MM) for each in apart)
            for center_mm in case.truth_mm:
                own = [pair for pair in found if np.linalg.norm(pair[0].center_mm - center_mm) <= FOUND_WITHIN_MM]
                if not own:
                    self.missed += 1
                    continue
                (one, is_flagged), error = own[0], own[0][0].center_mm - center_mm
                self.errors_mm.append(float(np.linalg.norm(error)))
                self.within.append(bool(error @ np.linalg.solve(one.covariance_mm2, error) <= CHI2_95))
                self.flagged.append(is_flagged)

    @property
    def markers(self) -> int:
        """Markers that should have been found so far."""
        return len(self.errors_mm) + self.missed

    def line(self, name: str) -> list[str]:
        """One line of the table."""
        found = len(self.errors_mm)
        counts = [name, *map(str, (self.markers, found, self.missed, self.false))]
        if not found:
            return [*counts, *["-"] * 7]
        errors_um, within, flagged = 1e3 * np.array(self.errors_mm), np.array(self.within), np.array(self.flagged)
        silent = ~within & ~flagged
        return [
            *counts,
            f"{errors_um.mean():.0f}",
            f"{errors_um.max():.0f}",
            f"{flagged.sum()}",
            f"{within.mean():.0%}",
            f"{1.0 - silent.mean():.0%}",
            f"{silent.sum()}",
            f"{errors_um[silent].max(initial=0.0):.0f}" if silent.any() else "-",
        ]


def scan(row: Row, number: int, first: int, protocol: str, cache: Path | None) -> list[Case]:
    """Scan a patient: the surroundings of each marker and decoy; the markers of all rows stand alike.

    They are kept in ``cache``, or taken from there.
    """
    seed = first + SEED_STEP * number
    share = [f"{row.covered:.0%}"] if row.covered < 1.0 else []
    made = ", ".join(
        [row.kind, row.covering or "bare", *share, *["as made"] * row.is_as_made, *["touching"] * row.touches]
    )
    kept = cache / f"{protocol}-{made}-{seed}.npz" if cache else None
    if kept is not None and kept.exists():
        return kept_cases(kept)
    feet = MARKERS_EACH // 2 if row.touches else MARKERS_EACH
    patient = random_patient(
        seed,
        protocol=protocol,
        kind=row.kind,
        covering=row.covering,
        covered=row.covered,
        as_made=row.is_as_made,
        count=feet,
        touching=feet if row.touches else 0,
        decoys=DECOYS_EACH,
    )
    return scanned(patient, row.kind, kept)


def main() -> None:
    """Scan, localize, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", default="axial", help="a protocol of the phantoms (default axial)")
    parser.add_argument("--markers", type=int, default=MARKERS_EACH, metavar="N", help="of each row at least")
    parser.add_argument("--first", type=int, default=FIRST_UNSEEN, metavar="SEED")
    parser.add_argument("--cache", type=Path, metavar="FOLDER", help="keep the scans there, and take those kept")
    parser.add_argument("--row", action="append", default=[], metavar="NAME", help="these rows only")
    arguments = parser.parse_args()
    if arguments.cache:
        arguments.cache.mkdir(parents=True, exist_ok=True)
    lines = [["", *HEADING]]
    for row in ROWS:
        if arguments.row and row.name not in arguments.row:
            continue
        score = Score()
        for number in itertools.count():
            if score.markers >= arguments.markers:
                break
            try:
                cases = scan(row, number, arguments.first, arguments.protocol, arguments.cache)
            except PhantomError:  # drawn with things inside each other: the next patient takes his place
                continue
            score.add([replace(case, diameter_mm=row.shown_mm or case.diameter_mm) for case in cases], row.build)
        lines.append(score.line(row.name))
        print("  ".join(lines[-1]), file=sys.stderr, flush=True)
    print(align(lines))


if __name__ == "__main__":
    main()
