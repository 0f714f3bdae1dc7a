"""What is stated of three pairs is a probability: of scenes drawn from what is believed so many are wrong as stated."""

import math

import numpy as np

from ronnaplan.correspondence.evidence import SCALE_PRIORS, SCALES
from ronnaplan.correspondence.many import match_many
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.priors import residual_priors, size_priors
from ronnaplan.correspondence.told import OTHER_PATIENT, Told
from ronnaplan.geometry import FloatArray
from tests.correspondence.scenes import SIGMA_CT, SIGMA_OTS, ball
from tests.long import few_or_all

SPREAD, FIELD = 60.0, 300.0
EDGES = (0.0, 0.5, 0.8, 0.9, 0.99, 1.0)
SAMPLING_ERRORS = 2.5


def believed_scenes(
    rng: np.random.Generator, tests: int, markers: int, outliers: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Points (T, n, 3) of CT and of the tracker, and true partners (T, n), drawn from the belief of three pairs.

    Markers are normal about a center that is anywhere in either field, outliers uniform, and all points lie in the
    field; errors are of each scale as often as believed.  The sets are not turned, for all this looks
    alike from all sides.
    """
    drawn = 6 * tests
    scale = rng.choice(SCALES, drawn, p=SCALE_PRIORS)[:, None, None]
    layout = SPREAD * rng.normal(size=(drawn, markers, 3))
    layout -= layout.mean(axis=1, keepdims=True)
    sets = [
        layout + ball(rng, drawn, FIELD)[:, None] + scale * sigma * rng.normal(size=layout.shape)
        for sigma in (SIGMA_CT, SIGMA_OTS)
    ]
    inside = np.all([np.linalg.norm(points, axis=2).max(axis=1) < FIELD for points in sets], axis=0)
    kept = np.flatnonzero(inside)[:tests]
    assert len(kept) == tests
    ct, ots = (
        np.concatenate((points[kept], ball(rng, tests * outliers, FIELD).reshape(tests, -1, 3)), axis=1)
        for points in sets
    )
    order = np.argsort(rng.random((tests, markers + outliers)), axis=1)
    partner = np.argsort(order, axis=1)
    partner[:, markers:] = -1
    return ct, np.ascontiguousarray(np.take_along_axis(ots, order[:, :, None], axis=1)), partner


@few_or_all("tests", 10_000, 30_000)
def test_as_many_answers_are_wrong_as_stated_where_all_is_as_believed(tests: int) -> None:
    """But for another patient, who is neither drawn nor believed in here.

    A bound on what the search leaves out that is too loose makes the statement too modest, the more so as the
    field's volume is told from the points: with outliers, the markers make it seem too small.
    """
    markers, outliers = 3, 6
    ct, ots, true = believed_scenes(np.random.default_rng(2), tests, markers, outliers)
    size = markers + outliers
    constants, background = size_priors((size, size), Told(expected=markers))
    priors = (constants, math.log(math.exp(background) - OTHER_PATIENT)), residual_priors((size, size))
    partner, probability, _ = match_many(ct, ots, SIGMA_CT**2 + SIGMA_OTS**2, *priors, SPREAD)
    stated = probability > 0  # the others are looked at more closely
    wrong = (partner != true).any(axis=1)[stated]
    bins = np.digitize(probability[stated], EDGES[1:-1])
    doubt = np.bincount(bins, 1.0 - probability[stated])
    found = np.bincount(bins, wrong)
    assert (np.abs(found - doubt) < SAMPLING_ERRORS * np.sqrt(doubt)).all(), (doubt, found)
