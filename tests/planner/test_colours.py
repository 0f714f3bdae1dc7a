"""Trajectories, markers, crosshair and proposals are told apart, by colour-blind eyes too."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from ronnaplan.planner.over_head import CROSS_COLOUR
from ronnaplan.planning.trajectory import COLOURS
from ronnaplan.scene.things import MARKER_COLOUR, PROPOSAL_COLOURS, PROPOSED_COLOUR

EYES = {
    "most": np.eye(3),
    "no long": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no medium": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "no short": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}
"""Which cones there are -> linear RGB as such eyes see it (Machado, Oliveira and Fernandes 2009)."""

XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
LEAST = 9.0
"""Of CIE 1976; 2.3 is just seen side by side."""


def lab(colour: np.ndarray, eye: np.ndarray) -> np.ndarray:
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    share = XYZ @ np.clip(eye @ linear, 0, 1) / np.array([0.9505, 1.0, 1.089])
    x, y, z = np.where(share > 0.008856, np.cbrt(share), 7.787 * share + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def parsed(colour: str) -> np.ndarray:
    return np.array([int(colour[n : n + 2], 16) for n in (1, 3, 5)]) / 255


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
def test_no_two_kinds_share_a_colour(eye: np.ndarray) -> None:
    kinds = {"marker": [MARKER_COLOUR], "crosshair": [CROSS_COLOUR], "proposed": [PROPOSED_COLOUR]} | {
        one: [one] for one in COLOURS
    }
    seen = {name: [lab(parsed(one), np.asarray(eye)) for one in some] for name, some in kinds.items()}
    worst, best = map(parsed, PROPOSAL_COLOURS)
    seen["proposals"] = [lab(worst + share * (best - worst), np.asarray(eye)) for share in np.linspace(0, 1, 11)]
    for one, other in combinations(seen, 2):
        nearest = min(float(np.linalg.norm(a - b)) for a in seen[one] for b in seen[other])
        assert nearest > LEAST, (one, other)


def test_numbers_of_proposed_entries_are_read_on_the_map_of_their_scores() -> None:
    """As WCAG asks of what is large, and of marks; letters have a dark rim besides."""

    def light(colour: str) -> float:
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parsed(colour).tolist()]
        return float(XYZ[1] @ linear)

    for below in PROPOSAL_COLOURS:
        assert (light(PROPOSED_COLOUR) + 0.05) / (light(below) + 0.05) >= 3.0
