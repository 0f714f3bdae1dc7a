"""Markers as a scan may show them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ronnaplan.localization.examine import Examined
from ronnaplan.localization.fit.parameters import BLUR, EDGE, RADIUS, SHAPE, WIDTH


def at(ball: Examined, x_mm: float, **changes: float) -> Examined:
    theta = ball.parameters.copy()
    for name, value in changes.items():
        theta[{"blur": BLUR, "edge": EDGE, "width": WIDTH, "radius": RADIUS, "shape": SHAPE}[name]] = value
    return replace(ball, center_mm=ball.center_mm + np.array([x_mm, 0.0, 0.0]), parameters=theta)
