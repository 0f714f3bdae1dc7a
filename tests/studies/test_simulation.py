import json
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.correspondence import match_by_similarity, match_points
from ronnaplan.correspondence.told import Told
from ronnaplan.studies.cells import DRAWN, Cell, add, further_cells, protocol_cells
from ronnaplan.studies.heads import HEADS_MM, X_FRAME_MM
from ronnaplan.studies.judging import judge_exact, judge_published
from ronnaplan.studies.scenes import random_rotations, simulate_scenes, uniform_in_ball
from ronnaplan.studies.simulation import run_block, run_simulation
from ronnaplan.studies.tables import tables
from tests.long import few_or_all


def test_the_protocol_is_the_papers() -> None:
    cells = protocol_cells()
    assert len(cells) == len(set(cells)) == 90
    assert {cell.markers for cell in cells} == {3, 4, 5, 6, 7, 8}
    assert {cell.outliers for cell in cells} == {0, 1, 2, 3, 4}
    assert not set(cells) & set(further_cells())


def test_scenes_have_the_stated_errors_and_a_true_partner() -> None:
    scenes = simulate_scenes(np.random.default_rng(1), HEADS_MM[0], 2000, 6, 3, hidden=1)
    assert scenes.ct.shape == (2000, 9, 3)
    assert scenes.ots.shape == (2000, 8, 3)
    assert (scenes.partner[:, 0] == -1).all()
    assert (scenes.partner[:, 6:] == -1).all()
    difference = []
    for ct, ots, partner in zip(scenes.ct, scenes.ots, scenes.partner, strict=True):
        seen = ots[partner[1:6]]
        d_ct, d_ots = (np.linalg.norm(points[0] - points[1]) for points in (ct[1:6], seen))
        difference.append(d_ct - d_ots)
    assert np.std(difference) == pytest.approx(np.sqrt(2 * (0.56**2 + 0.17**2)), rel=0.05)


def test_outliers_and_rotations_are_uniform() -> None:
    rng = np.random.default_rng(2)
    radius = np.linalg.norm(uniform_in_ball(rng, (20_000,), 300.0), axis=1)
    assert np.mean(radius < 150) == pytest.approx(1 / 8, abs=0.01)
    turned = random_rotations(rng, 20_000)
    assert np.allclose(turned @ turned.transpose(0, 2, 1), np.eye(3))
    assert np.allclose(np.linalg.det(turned), 1)
    assert np.abs(turned.mean(axis=0)).max() < 0.02


def test_the_frame_has_distances_that_the_paper_calls_unique() -> None:
    distances = np.sort(np.linalg.norm(X_FRAME_MM[:, None] - X_FRAME_MM[None], axis=-1)[np.triu_indices(4, 1)])
    assert np.diff(distances).min() > 5.0


@pytest.mark.parametrize("expected", [4, None])
def test_the_study_judges_as_the_public_functions_do(expected: Any) -> None:
    scenes = simulate_scenes(np.random.default_rng(3), HEADS_MM[1], 60, 4, 2)
    refused = {"exact": 0, "published": 0}
    for ct, ots in zip(scenes.ct, scenes.ots, strict=True):
        refused["exact"] += match_points(ct, ots, expected).status != "unique"
        refused["published"] += match_by_similarity(ct, ots, 4, one_to_one=False).status != "unique"
    assert judge_exact(scenes, Told(expected))["exact"][1] == refused["exact"]
    assert judge_published(scenes, 4, one_to_one=False)[1] == refused["published"]


def test_every_cell_can_be_run() -> None:
    for cell in further_cells():
        if cell.head == 1:
            assert sum(run_block(*astuple(cell), 0, 2, 7)["exact"]) == 2, cell


def test_a_block_depends_on_its_seed_only() -> None:
    block = (0, 3, 2, 0, 3, 0, 100, 7, 50)
    assert run_block(*block, 1) == run_block(*block, 1)
    assert run_block(*block, 1) != run_block(*block, 2)


def test_the_goals_hold_on_a_sample() -> None:
    """A thousandth of the study; the whole is in docs/correspondence.md."""
    limits = {(3, 0): 11.0, (3, 4): 17.0, (4, 4): 1.0, (5, 2): 0.2, (8, 4): 0.1}
    for (markers, outliers), percent in limits.items():
        blocks = [run_block(head, markers, outliers, 0, markers, 0, 100, 0, 500, 2018) for head in range(3)]
        right, refused, wrong = add(add(blocks[0], blocks[1]), blocks[2])["exact"]
        assert wrong <= (1 if markers == 3 else 0)
        assert 100 * refused / (right + refused + wrong) <= percent, (markers, outliers)


@few_or_all("scenes", 150, 500)
def test_stated_probabilities_are_calibrated_on_a_sample(scenes: int) -> None:
    blocks = [run_block(head, 3, o, 0, 3, 0, DRAWN, 1, scenes, 2018) for head in range(3) for o in (0, 2)]
    total = blocks[0]
    for block in blocks[1:]:
        total = add(total, block)
    bins = np.array(total["calibration"])
    expected = bins[:, 2].sum()
    assert bins[:, 1].sum() == pytest.approx(expected, abs=2.5 * np.sqrt(bins[:, 0].sum() - expected))


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plots take longer than what they show; `test_command` looks for them."""
    for name in ("plot_outcomes", "plot_calibration"):
        monkeypatch.setattr(f"ronnaplan.studies.plots.{name}", lambda by_cell, path: None)


@pytest.mark.usefixtures("undrawn")
def test_the_study_is_the_same_for_any_number_of_workers(tmp_path: Path) -> None:
    for workers in (1, 2):
        run_simulation(tmp_path / str(workers), 3, 5, further=False, workers=workers)
    documents = [json.loads((tmp_path / str(w) / "results.json").read_text()) for w in (1, 2)]
    assert documents[0] == documents[1]


@pytest.mark.usefixtures("undrawn")
def test_a_cluster_of_two_workers_gets_the_same_numbers(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    here = run_simulation(tmp_path / "here", 2, 6, further=False, workers=1)
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address=None,
    ) as cluster:
        there = run_simulation(tmp_path / "there", 2, 6, further=False, scheduler=cluster.scheduler_address)
    assert here == there


def test_the_tables_name_every_condition() -> None:
    by_cell = {Cell(0, 8, 2, hidden=1): run_block(0, 8, 2, 1, 0, 0, 100, 0, 5, 1)}
    assert "| 8 | 2 | 1 | nothing | 100 % |" in tables(by_cell)
