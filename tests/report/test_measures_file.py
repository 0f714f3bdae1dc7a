"""The table of a case's measures holds what `plan check -o` writes, one row a trajectory."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.case.folder import Case
from ronnaplan.case.surroundings import Rules
from ronnaplan.documents.plan_measures import measures_document
from ronnaplan.errors import InputError
from ronnaplan.planning import Landmarks, Limits
from ronnaplan.report.measures_file import HEADER, measures_csv
from tests import cases


def rows(case: Case) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(measures_csv(case, "case 7"))))


@pytest.fixture(scope="module")
def case() -> Case:
    """A trajectory that can be measured, and one that ends in air."""
    plan = cases.plan()
    entry_mm, in_air_mm = np.array([-30.0, -20.0, 84.0]), np.array([0.0, 0.0, 110.0])
    plan = plan.add(replace(plan.trajectories[0], name="right", entry_mm=entry_mm, target_mm=in_air_mm))
    points = Landmarks(np.array([0.5, -12.0, 22.0]), np.array([0.5, 12.0, 22.0]), np.array([0.5, 0.0, 60.0]))
    return Case(cases.volume(), plan.with_landmarks(points), cases.fiducials(), cases.registration())


def test_each_figure_is_that_of_the_document(case: Case) -> None:
    assert case.plan is not None
    left, right = rows(case)
    judged = case.surroundings.judge(case.plan.trajectories[0], case.plan)
    assert judged.measures is not None
    (one,) = json.loads(measures_document(case.plan, [judged.measures], judged.verdicts))["trajectories"]
    expected = {name: one[name] for name in HEADER if name in one and name != "name"}
    expected |= one["arc_and_ring"] | {
        f"acpc_{angle}": one["ac_pc"][angle] for angle in ("sagittal_deg", "coronal_deg")
    }
    ways = ("mcp_right_mm", "mcp_anterior_mm", "mcp_superior_mm")
    expected |= dict(zip(ways, one["ac_pc"]["target_mm"], strict=True))
    for basis, error in (("registered", one["expected_error"]), ("planned", one["planned_error"])):
        assert error["basis"] == basis
        expected |= {
            f"{basis}_entry_rms_mm": error["tre_rms_mm"][0],
            f"{basis}_target_rms_mm": error["tre_rms_mm"][-1],
        }
        expected |= {f"{basis}_{name}": error[name] for name in ("angular_rms_deg", "tolerance_mm", "probability")}
    assert {name: float(left[name]) for name in expected} == expected
    assert set(HEADER) - set(expected) == {"case", "name", "verdict", "remarks", "frame_of_reference_uid"}
    assert (left["case"], left["name"], left["verdict"]) == ("case 7", "left", "pass")
    assert "registration: the residuals are far smaller than the stated marker errors" in left["remarks"]
    assert (right["verdict"], right["length_mm"], right["planned_probability"]) == ("not judged", "", "")
    assert "the target of right at LPS (0.0, 0.0, 110.0) lies in air" in right["remarks"]


def test_a_broken_limit_is_told_and_what_is_not_known_is_left_empty(case: Case) -> None:
    strict = replace(case, plan=cases.plan(), rules=Rules(Limits(longest_path_mm=10.0)), registration=None)
    (row,) = rows(strict)
    assert row["verdict"] == "FAIL"
    assert "(limit 10.00)" in row["remarks"]
    assert (row["mcp_right_mm"], row["registered_target_rms_mm"]) == ("", "")
    assert float(row["planned_target_rms_mm"]) > 0


def test_a_case_without_trajectories_has_no_table(case: Case) -> None:
    with pytest.raises(InputError, match="case 7 holds no trajectory to be measured"):
        measures_csv(replace(case, plan=None), "case 7")
