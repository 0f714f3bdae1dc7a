"""Whatever points are given, on one line, in one place, huge or few, they are paired and registered, or refused."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan import describe_layout, match_points, register_points
from ronnaplan.errors import RonnaplanError
from ronnaplan.geometry import FloatArray, Points
from ronnaplan.registration.diagnosis import doubted_marker
from ronnaplan.registration.drift import check_drift
from ronnaplan.registration.planned import predict_tre
from tests.long import few_and_others

SETS = 80
TRIED_EACH_TIME = 24
Answer = TypeVar("Answer")
COUNTS = (0, 1, 2, 3, 3, 4, 4, 5, 6, 8, 12)


def any_points(generator: np.random.Generator, count: int) -> FloatArray:
    """Points of any size, half of them regular in some way."""
    points: FloatArray = generator.standard_normal((count, 3)) * generator.choice([1e-3, 1.0, 60.0, 1e4])
    kind = generator.integers(0, 10)
    if kind == 0:
        points[:, 2] = 0.0
    elif kind == 1:
        points[:, 1:] = 0.0
    elif kind == 2:
        points[count // 2 :] = points[:1]
    elif kind == 3:
        points = np.round(points)
    elif kind == 4:
        angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
        points = 50.0 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=-1)
    return points


def any_covariances(generator: np.random.Generator, count: int) -> FloatArray:
    """Covariances of any size, some of them flat, or none."""
    roots = generator.standard_normal((count, 3, 3)) * generator.choice([0.0, 1e-6, 0.01, 0.3, 100.0])
    covariances: FloatArray = roots @ roots.swapaxes(1, 2) + generator.choice([0.0, 1e-9, 1e-4]) * np.eye(3)
    return covariances


def answered(work: Callable[[], Answer]) -> Answer | None:
    """What ``work`` returns; None where it refuses."""
    try:
        return work()
    except RonnaplanError:
        return None


@few_and_others("seed", range(TRIED_EACH_TIME), range(TRIED_EACH_TIME, SETS))
def test_any_points_are_answered_or_refused(seed: int) -> None:
    generator = np.random.default_rng([seed, 9])
    count = int(generator.choice(COUNTS))
    ct_mm = any_points(generator, count)
    turn = Rotation.random(random_state=seed).as_matrix()
    ots_mm = ct_mm @ turn.T + 100.0 + generator.choice([0.0, 0.1, 20.0]) * generator.standard_normal(ct_mm.shape)
    read_mm = generator.permutation(np.concatenate([ots_mm, any_points(generator, int(generator.integers(0, 4)))]))
    ct_mm2, ots_mm2 = any_covariances(generator, count), any_covariances(generator, count)
    read_mm2 = any_covariances(generator, len(read_mm))
    answered(lambda: match_points(ct_mm, read_mm))
    answered(lambda: match_points(ct_mm, read_mm, covariances_ct_mm2=ct_mm2, covariances_ots_mm2=read_mm2))
    answered(lambda: describe_layout(ct_mm))
    answered(lambda: predict_tre(ct_mm, ct_mm2, any_points(generator, 3)))
    for covariances in (None, (ct_mm2, ots_mm2)):
        found = answered(partial(register_points, ct_mm, ots_mm, covariances))
        if found is not None:
            assert np.isfinite(found.pose.matrix).all()
            answered(partial(doubted_marker, found))
    labels = tuple(map(str, range(count)))
    answered(lambda: check_drift(Points(ct_mm, ct_mm2, labels), Points(ct_mm + 0.1, ots_mm2, labels[::-1])))
