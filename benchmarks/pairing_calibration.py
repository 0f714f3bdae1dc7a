"""Whether what is stated of three markers' pairing is a probability: wrong answers against stated doubt, by bin.

    python -m benchmarks.pairing_calibration [--tests N] [--seed N]

What is stated is the posterior under a belief: true errors of half to four times the stated ones (`evidence.SCALES`),
markers that lie about their center with `SPREAD_MM` per axis, and now and then another patient's
(`told.OTHER_PATIENT`).  So it is looked at under that belief whole but for its last part (another patient is neither
simulated nor believed in), which asks the sums alone; then on the study's heads, whose markers lie closer together;
and under other errors.  Each scale is simulated alike often and counts with its share.  Whole answers count, accepted
or not; of another patient, all are wrong.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import numpy as np

from ronnaplan.correspondence.evidence import SCALE_PRIORS, SCALES
from ronnaplan.correspondence.many import match_many
from ronnaplan.correspondence.priors import SPREAD_MM, residual_priors, size_priors
from ronnaplan.correspondence.told import OTHER_PATIENT, Told
from ronnaplan.geometry import FloatArray
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.studies.heads import HEADS_MM
from ronnaplan.studies.judging import PROBABILITY_EDGES, calibration
from ronnaplan.studies.scenes import OUTLIER_RADIUS_MM, Scenes, shuffled, simulate_scenes, uniform_in_ball

MARKERS, OUTLIERS = 3, (0, 2, 4)


@dataclass(frozen=True)
class Truth:
    """What is true: the shares of `SCALES` and of another patient, and where markers lie; and what else is believed.

    ``is_layout_believed``: markers are drawn from the belief in place of the study's heads.  ``spread_mm``: what is
    stated of how widely they lie.
    """

    name: str
    scales: tuple[float, ...]
    stranger: float = 0.0
    is_stranger_believed: bool = True
    is_layout_believed: bool = False
    spread_mm: float = SPREAD_MM


TRUTHS = (
    Truth("all as believed, but never another patient, nor believed", SCALE_PRIORS, 0.0, False, True),
    Truth("errors as believed, never another patient, nor believed", SCALE_PRIORS, 0.0, False),
    Truth("the same, a spread of 50 mm stated", SCALE_PRIORS, 0.0, False, spread_mm=50.0),
    Truth("as believed, another patient in 1 of 20", SCALE_PRIORS, OTHER_PATIENT),
    Truth("scales in equal shares", (1.0 / len(SCALES),) * len(SCALES)),
    Truth("errors as stated", tuple(float(scale == 1.0) for scale in SCALES)),
    Truth("errors four times as stated", tuple(float(scale == 4.0) for scale in SCALES)),
)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tests", type=int, default=120_000, help="tests of each scale and number of outliers")
    parser.add_argument("--seed", type=int, default=51_993)
    arguments = parser.parse_args()
    cells = " | ".join(f"{MARKERS} + {outliers}" for outliers in OUTLIERS)
    for truth in TRUTHS:
        columns = [lines(truth, outliers, arguments.tests, arguments.seed) for outliers in OUTLIERS]
        print(f"\n{truth.name}: wrong as stated / wrong, %\n\n| stated | {cells} |\n|---|---|---|---|")
        for low, high, *cell in zip(PROBABILITY_EDGES, PROBABILITY_EDGES[1:], *columns, strict=False):
            print(f"| {low:g} to {high:g} | {' | '.join(cell)} |")


def lines(truth: Truth, outliers: int, tests: int, seed: int) -> list[str]:
    """Return, for each bin, the stated and the observed share of wrong answers with its sampling error, in percent."""
    total = variance = np.zeros((len(PROBABILITY_EDGES) - 1, 3))
    for scale, share in zip(SCALES, truth.scales, strict=True):
        for is_stranger, weight in ((False, share * (1.0 - truth.stranger)), (True, share * truth.stranger)):
            if weight:
                here = counts(truth, outliers, scale, is_stranger, tests, seed)
                total, variance = total + weight * here, variance + weight**2 * here
    found = 100.0 * total[:, 1:] / np.maximum(total[:, :1], 1e-9)
    error = 100.0 * np.sqrt(variance[:, 2]) / np.maximum(total[:, 0], 1e-9)
    return [f"{doubt:.2g} / {wrong:.2g} ± {by:.2g}" for (doubt, wrong), by in zip(found, error, strict=True)]


def counts(truth: Truth, outliers: int, scale: float, is_stranger: bool, tests: int, seed: int) -> FloatArray:
    """Return (B, 3) for each bin: answers, the sum of their stated doubts, and how many are wrong."""
    size, variance = MARKERS + outliers, SIGMA_CT_MM**2 + SIGMA_OTS_MM**2
    constants, background = size_priors((size, size), Told(expected=MARKERS))
    if not truth.is_stranger_believed:
        background = math.log(math.exp(background) - OTHER_PATIENT)
    priors = (constants, background), residual_priors((size, size))
    total = np.zeros((len(PROBABILITY_EDGES) - 1, 3))
    for head, layout in enumerate(HEADS_MM):
        rng = np.random.default_rng([seed, outliers, int(10 * scale), is_stranger, head])
        count = tests // len(HEADS_MM)
        if truth.is_layout_believed:
            scenes = believed_scenes(rng, count, outliers, scale)
        else:
            scenes = simulate_scenes(rng, layout, count, MARKERS, outliers, noise=scale)
        ots = scenes.ots
        if is_stranger:
            another = HEADS_MM[(head + 1) % len(HEADS_MM)]
            ots = simulate_scenes(rng, another, len(ots), MARKERS, outliers, noise=scale).ots
        partner, probability, _ = match_many(scenes.ct, ots, variance, *priors, truth.spread_mm)
        wrong = (partner != scenes.partner).any(axis=1) | is_stranger
        stated = probability > 0
        answers, right, sure = np.array(calibration(probability[stated], ~wrong[stated])).T
        total += np.column_stack([answers, answers - sure, answers - right])
    return total


def believed_scenes(rng: np.random.Generator, tests: int, outliers: int, scale: float) -> Scenes:
    """Simulate what the evidence takes for true: normal markers anywhere in a field that holds all points.

    Turning the readings would change nothing, for all this looks alike from all sides.
    """
    drawn = 6 * tests
    layout = SPREAD_MM * rng.standard_normal((drawn, MARKERS, 3))
    layout -= layout.mean(axis=1, keepdims=True)
    read = [
        layout
        + uniform_in_ball(rng, (drawn, 1), OUTLIER_RADIUS_MM)
        + scale * sigma * rng.standard_normal(layout.shape)
        for sigma in (SIGMA_CT_MM, SIGMA_OTS_MM)
    ]
    farthest = np.max([np.linalg.norm(points, axis=2).max(axis=1) for points in read], axis=0)
    inside = np.flatnonzero(farthest < OUTLIER_RADIUS_MM)[:tests]
    ct, ots = (
        np.concatenate((points[inside], uniform_in_ball(rng, (len(inside), outliers), OUTLIER_RADIUS_MM)), axis=1)
        for points in read
    )
    return shuffled(rng, ct, ots, MARKERS)


if __name__ == "__main__":
    main()
