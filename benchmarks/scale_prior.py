"""What a prior of the errors' scale costs three markers, and what it saves: refusals against wrong answers.

    python -m benchmarks.scale_prior [--tests N] [--seed N] [-o docs/images/correspondence_scale.png]

Every pairing of a test is weighed at each scale of the errors; then rules decide on the same tests: a prior of the
scale and a level each, one that knows what it is judged by (the likelihood as stated of the best pairing against that
of the others were the errors four times as large), and the matcher's: its prior at 0.99, and the best has to stand
against the others at four times (`MOST_ODDS_IF_LARGER`, the dot); and one for the worst case, whose odds have to hold
at every scale that the best pairing's residuals do not exclude.  What ``match_points`` looks at more closely is not
counted.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.correspondence.evidence import (
    GATE_CHI2,
    MOST_ODDS_IF_LARGER,
    SCALE_PRIORS,
    SCALES,
    filled_volume,
    log_misfit,
)
from ronnaplan.correspondence.exact import LISTED_NATS, search
from ronnaplan.correspondence.pairing import LEAST_PROBABILITY
from ronnaplan.correspondence.priors import size_priors
from ronnaplan.correspondence.told import Told
from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.studies.heads import HEADS_MM
from ronnaplan.studies.plots import new_figure, save
from ronnaplan.studies.scenes import simulate_scenes

MARKERS, OUTLIERS = 3, (0, 2, 4)
WEIGHED = (0.5, 2**-0.5, 1.0, 2**0.5, 2.0, 8**0.5, 4.0)
LEVELS = 1.0 - np.geomspace(0.2, 2e-4, 31)
SHOWN = {f"{level:g}": level for level in (0.98, 0.99, 0.995)}
GOAL, LEAST_DRAWN = 0.05, 0.015
"""Of the answers, percent: the goal, and what so many tests can tell."""

BoolArray = NDArray[np.bool_]
Judged = dict[float, tuple[FloatArray, BoolArray]]
"""Of each true scale what `judge` returns."""

Tests = list[tuple[FloatArray, BoolArray]]
"""Of each test the log evidence of every pairing at each of `WEIGHED` (L, S), and which is right (L,)."""


def on(scales: dict[float, float]) -> FloatArray:
    """Return weights of `WEIGHED`, log."""
    with np.errstate(divide="ignore"):
        return np.log([scales.get(scale, 0.0) for scale in WEIGHED])


MATCHER = on(dict(zip(SCALES, SCALE_PRIORS, strict=True)))
RULES = {
    "as stated for certain": (on({1.0: 1.0}), on({1.0: 1.0})),
    "log-uniform": (on(dict.fromkeys(WEIGHED, 1 / len(WEIGHED))),) * 2,
    "the matcher's prior": (MATCHER, MATCHER),
    "the best as stated, others four times": (on({0.5: 0.15, 1.0: 0.85}), on({1.0: 0.3, 4.0: 0.7})),
}
"""Weights of the scales for the best pairing, and for all others."""

BOTH = "the matcher's prior at 0.99, and others at four times"
ODDS_OF_BOTH = {f"1/{against}": against / (1.0 + against) for against in (25, 40, 50, 75, 100, 150)}
"""Of the others at four times, at most, as levels; 0.99 refuses already where they have 1/25."""

MOST_POWERFUL = "the likelihood ratio where its prior gives 0.99"
RATIOS = {f"1/{against}": against / (1.0 + against) for against in (50, 100, 150, 250, 400)}


WORST_CASE = "at every scale of half to four times where its prior gives 0.99"
NOT_EXCLUDED = math.log(20.0)
"""Scales at which the best pairing is less probable by more than this than at its best one are excluded."""


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tests", type=int, default=30_000, help="tests a cell")
    parser.add_argument("--seed", type=int, default=70_617)
    parser.add_argument("-o", type=Path, default=Path("correspondence_scale.png"), metavar="PNG")
    arguments = parser.parse_args()
    figure, axes = new_figure(1, len(OUTLIERS), 11.0, 4.0)
    print(
        "| markers + outliers | rule, level | refused, errors as stated | wrong of the answers, half to four times |"
    )
    print("|---|---|---|---|")
    for axis, outliers in zip(np.ravel(axes), OUTLIERS, strict=True):
        cells = {scale: weighed_tests(outliers, scale, arguments.tests, arguments.seed) for scale in SCALES}
        for name, weights in RULES.items():
            judged = {scale: judge(*tests, *weights) for scale, tests in cells.items()}
            draw(axis, name, judged, LEVELS)
            write(outliers, name, judged, SHOWN)
        both = {scale: judge_both(*tests) for scale, tests in cells.items()}
        draw(axis, BOTH, both, 1.0 / (1.0 + np.geomspace(0.04, 0.002, 31)))
        write(outliers, BOTH, both, ODDS_OF_BOTH)
        ratio = {scale: judge_ratio(*tests) for scale, tests in cells.items()}
        write(outliers, MOST_POWERFUL, ratio, RATIOS)
        for name, most in (("not excluded", NOT_EXCLUDED), ("any", np.inf)):
            worst = {scale: judge_worst_case(*tests, most) for scale, tests in cells.items()}
            write(outliers, f"{WORST_CASE}, {name}", worst, ODDS_OF_BOTH)
        share, errors = rates(both, 1.0 / (1.0 + MOST_ODDS_IF_LARGER))
        axis.plot(share, max(errors[-1], 1e-3), "ko", ms=7, zorder=5)
        axis.axhline(GOAL, color="0.6", ls=":", lw=1)
        axis.set(title=f"{MARKERS} markers + {outliers} outliers", yscale="log", xlim=(0, 40), ylim=(1e-2, 30))
        axis.set_xlabel("refused, errors as stated, %")
    np.ravel(axes)[0].set_ylabel("wrong of the answers, errors four times, %")
    figure.legend(*np.ravel(axes)[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    save(figure, arguments.o)


def draw(axis: Any, name: str, judged: Judged, levels: FloatArray) -> None:
    """Draw what a rule refuses and gets wrong over its levels."""
    refused, wrong = (np.array(share) for share in zip(*(rates(judged, level) for level in levels), strict=True))
    axis.plot(refused, np.where(wrong[:, -1] > LEAST_DRAWN, wrong[:, -1], np.nan), label=name, lw=1.5)


def write(outliers: int, name: str, judged: Judged, levels: dict[str, float]) -> None:
    """Print a row of the table for each level."""
    for text, level in levels.items():
        share, errors = rates(judged, level)
        shown = ", ".join(f"{error:.3f}" for error in errors)
        print(f"| {MARKERS} + {outliers} | {name}, {text} | {share:.1f} | {shown} |", flush=True)


def weighed_tests(outliers: int, scale: float, tests: int, seed: int) -> tuple[Tests, float]:
    """Return what every pairing of simulated tests weighs, and the log weight of nothing pairing."""
    variance = SIGMA_CT_MM**2 + SIGMA_OTS_MM**2
    count = MARKERS + outliers
    constants, background = size_priors((count, count), Told(expected=MARKERS))
    weight, node = np.full((count, count), 1 / variance), np.full((count, count), -1.5 * math.log(variance))
    known, spread, found = np.zeros((0, 2), np.int64), 60.0, []
    for head, layout in enumerate(HEADS_MM):
        rng = np.random.default_rng([seed, outliers, int(10 * scale), head])
        scenes = simulate_scenes(rng, layout, tests // len(HEADS_MM), MARKERS, outliers, noise=scale)
        for ct, ots, partner in zip(scenes.ct, scenes.ots, scenes.partner, strict=True):
            own = constants + (np.arange(len(constants)) - 1.0) * math.log(filled_volume(ct, ots))
            evidence, chi2, partners, _ = search(
                ct, ots, weight, node, own, known, spread, LISTED_NATS, -np.inf, GATE_CHI2
            )
            sizes = (partners >= 0).sum(axis=1)
            base = evidence - [log_misfit(square, size) for square, size in zip(chi2, sizes, strict=True)]
            at = np.array(WEIGHED)
            freedom = 3.0 * sizes[:, None] - 6.0
            here = base[:, None] - freedom * np.log(at) - 0.5 * chi2[:, None] / at**2
            found.append((here, (partners == partner).all(axis=1)))
    return found, background


def judge(tests: Tests, background: float, best: FloatArray, others: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the probability (T,) of each test's best pairing under a rule, and whether it is right (T,)."""
    odds, right = np.full(len(tests), -np.inf), np.zeros(len(tests), dtype=bool)
    for t, (evidence, is_right) in enumerate(tests):
        if len(evidence) == 0:
            continue
        own, rival = (np.logaddexp.reduce(evidence + weights, axis=1) for weights in (best, others))
        top = int(own.argmax())
        rival[top] = background
        odds[t], right[t] = own[top] - np.logaddexp.reduce(rival), is_right[top]
    return 1.0 / (1.0 + np.exp(-np.clip(odds, -700, 700))), right


def judge_both(tests: Tests, background: float) -> tuple[FloatArray, BoolArray]:
    """Return what `judge` does, of others at four times only; 0 where the matcher's prior refuses already."""
    probability = judge(tests, background, MATCHER, MATCHER)[0]
    against_larger, right = judge(tests, -np.inf, MATCHER, on({SCALES[-1]: 1.0}))
    return np.where(probability >= LEAST_PROBABILITY, against_larger, 0.0), right


def judge_ratio(tests: Tests, background: float) -> tuple[FloatArray, BoolArray]:
    """Return what `judge_both` does, by the likelihood of the points: as stated, against others at four times.

    No rule that refuses as rarely where errors are as stated pairs fewer tests wrongly where they are four times as
    large (the lemma of Neyman & Pearson 1933), but for what the prior refuses already.
    """
    probability, right = judge(tests, background, MATCHER, MATCHER)
    stated, larger = WEIGHED.index(1.0), WEIGHED.index(SCALES[-1])
    odds = np.full(len(tests), np.inf)
    for t, (evidence, _) in enumerate(tests):
        if len(evidence) > 1:
            others = np.delete(evidence[:, larger], int(np.logaddexp.reduce(evidence + MATCHER, axis=1).argmax()))
            odds[t] = np.logaddexp.reduce(evidence[:, stated]) - np.logaddexp.reduce(others)
    ratio = 1.0 / (1.0 + np.exp(-np.clip(odds, -700, 700)))
    return np.where(probability >= LEAST_PROBABILITY, ratio, 0.0), right


def judge_worst_case(tests: Tests, background: float, most: float) -> tuple[FloatArray, BoolArray]:
    """Return what `judge_both` does, by the worst of the scales at which the best pairing is ``most`` nats behind."""
    probability, right = judge(tests, background, MATCHER, MATCHER)
    odds = np.full(len(tests), np.inf)
    for t, (evidence, _) in enumerate(tests):
        if len(evidence) > 1:
            top = int(np.logaddexp.reduce(evidence + MATCHER, axis=1).argmax())
            ahead = evidence[top] - np.logaddexp.reduce(np.delete(evidence, top, axis=0), axis=0)
            odds[t] = ahead[evidence[top] >= evidence[top].max() - most].min()
    worst = 1.0 / (1.0 + np.exp(-np.clip(odds, -700, 700)))
    return np.where(probability >= LEAST_PROBABILITY, worst, 0.0), right


def rates(judged: Judged, level: float) -> tuple[float, list[float]]:
    """Return the share refused where errors are as stated, and of the answers the wrong at each scale, in percent."""
    refused = 100.0 * float((judged[1.0][0] < level).mean())
    wrong = [
        100.0 * float(np.logical_not(right[given >= level]).mean()) if (given >= level).any() else 0.0
        for given, right in judged.values()
    ]
    return refused, wrong


if __name__ == "__main__":
    main()
