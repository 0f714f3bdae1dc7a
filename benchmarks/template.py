"""Templates against markers on heads and anywhere on a plate: refusals and false answers by the paper's simulation.

python -m benchmarks.template [--tests 10000] [--outliers 0 2 4] [--seed 1]

Noise of 0.56 and 0.17 mm per axis, outliers in both sets, the number of markers told, as in section 4.2. Heads are
those of the study, each marker displaced within 10 mm; on a plate each stands within the tolerances of print and screws
about its place.
"""

from __future__ import annotations

import argparse

import numpy as np

from ronnaplan.correspondence.told import Told
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.template_layout import Bridge, design_template, random_holes
from ronnaplan.studies.heads import HEADS_MM
from ronnaplan.studies.judging import judge_exact, judge_published
from ronnaplan.studies.scenes import DISPLACEMENT_RADIUS_MM, simulate_scenes

RANDOM_PLATES = 50
BALL_SD = np.sqrt(5.0)
"""Radius of a ball over the standard deviation per axis of places in it."""


def outcomes(
    layouts_mm: list[FloatArray],
    displaced_mm: float,
    markers: int,
    outliers: int,
    tests: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return right, refused and wrong answers (3,), in percent, of this package and of the published algorithm."""
    ours, published = np.zeros(3), np.zeros(3)
    each = max(tests // len(layouts_mm), 1)
    for layout in layouts_mm:
        scenes = simulate_scenes(rng, layout, each, markers, outliers, displaced_mm=displaced_mm)
        ours += np.array(judge_exact(scenes, Told(expected=markers))["exact"], dtype=float)
        published += judge_published(scenes, markers, one_to_one=True)
    return 100 * ours / ours.sum(), 100 * published / published.sum()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tests", type=int, default=10_000)
    parser.add_argument("--outliers", type=int, nargs="+", default=[0, 2, 4])
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    bridge = Bridge()
    play_mm = bridge.sigma_mm * BALL_SD
    print(
        "| markers | outliers | layout | refused | wrong | published: refused | wrong |\n|---|---|---|---|---|---|---|"
    )
    for markers in (3, 4, 5):
        rng = np.random.default_rng([arguments.seed, markers])
        template = design_template(markers, bridge, seed=arguments.seed).centers_mm
        drawn = [random_holes(markers, bridge, rng) for _ in range(RANDOM_PLATES)]
        plates = [bridge.centers_mm(holes) for holes in drawn if holes is not None]
        kinds = {
            "template": ([template], play_mm),
            "anywhere on the plate": (plates, play_mm),
            "heads": (list(HEADS_MM), DISPLACEMENT_RADIUS_MM),
        }
        for outliers in arguments.outliers:
            for name, (layouts, displaced_mm) in kinds.items():
                ours, published = outcomes(layouts, displaced_mm, markers, outliers, arguments.tests, rng)
                print(
                    f"| {markers} | {outliers} | {name} | {ours[1]:.2f} % | {ours[2]:.3f} % "
                    f"| {published[1]:.2f} % | {published[2]:.3f} % |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
