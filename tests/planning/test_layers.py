"""One ray searched with arrays ends as the same ray does in the compiled search for many."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.planning.compiled import way_out as compiled_way_out
from ronnaplan.planning.layers import LONGEST_WAY_MM, STEP_MM, Way, way_out
from tests.long import few_and_others, few_or_all
from tests.planning.heads import scanned


@few_or_all("cases", 80, 200)
@few_and_others("stack", ["plain", "tilted"], ["uneven", "oblique"])
def test_both_searches_agree(stack: str, cases: int) -> None:
    head = scanned(stack, post=True, wire=True) if stack == "plain" else scanned(stack)
    scan, generator = head.scan, np.random.default_rng(8)
    ways = set()
    for _ in range(cases):
        start = generator.uniform(-1, 1, 3) * [50, 60, 50] + [0, 0, 20]
        outward = generator.standard_normal(3)
        outward /= np.linalg.norm(outward)
        one = way_out(scan, head.inside, head.cell, start, outward)
        places = (scan.axes @ start, scan.axes @ outward, np.empty(int(LONGEST_WAY_MM / STEP_MM)))
        many = compiled_way_out(
            scan.voxels, scan.origins_uv_mm, scan.w_mm, scan.steps_mm, head.inside, head.cell, *places
        )
        assert one[0] == many[0]
        assert one[1:] == pytest.approx(many[1:], abs=1e-6, nan_ok=True)
        ways.add(one[0])
    assert {Way.OPEN, Way.CUT} <= ways


def test_air_and_what_lies_outside_the_scan_are_told() -> None:
    scan = scanned("tilted").scan
    first = scan.axes.T @ np.array([*scan.origins_uv_mm[0], scan.w_mm[0]])
    assert scan.values_hu(
        np.array([first, first - 0.01 * scan.axes[2], first - 0.01 * scan.axes[0]])
    ) == pytest.approx([max(float(scan.voxels[0, 0, 0]), -1024.0), np.nan, np.nan], nan_ok=True)
