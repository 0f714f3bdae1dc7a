"""What an open case goes on to say after other hands' changes is what a case says that is judged from the beginning."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ronnaplan.case.edits import OpenCase
from ronnaplan.case.folder import CaseFiles
from ronnaplan.case.judgement import Judgement
from ronnaplan.case.surroundings import Rules, Surroundings
from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.documents.limits import read_limits
from ronnaplan.documents.plan import change_plan, read_plan
from ronnaplan.documents.plan_measures import measures_document
from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration import read_registration
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import INSTRUMENTS, Landmarks, Plan
from ronnaplan.planning.electrodes import ELECTRODES
from ronnaplan.planning.limits import is_near
from tests import cases
from tests.long import few_or_all

SEED = 20261127


class OtherHand:
    """Changes one thing of a case at random, in its files."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.random = folder, np.random.default_rng(SEED)
        names = ("left", "second", "third")
        for name in names[1:]:
            self.plan(partial(self.added, name))
        self.changes: tuple[Callable[[], None], ...] = (
            lambda: self.edit(target_mm=self.near(cases.TARGET_MM)),
            lambda: self.edit(instrument=list(INSTRUMENTS.values())[self.random.integers(len(INSTRUMENTS))]),
            lambda: self.edit(electrode=list(ELECTRODES.values())[self.random.integers(len(ELECTRODES))]),
            lambda: self.edit(notes=str(self.random.random())),
            lambda: self.plan(lambda plan: plan.undo() if len(plan.history) > len(names) else plan),
            lambda: self.plan(lambda plan: plan.with_landmarks(self.landmarks())),
            self.limits,
            self.markers,
        )

    def near(self, place_mm: FloatArray) -> FloatArray:
        return place_mm + self.random.integers(-1, 2, size=3) * 3.0

    def added(self, name: str, plan: Plan) -> Plan:
        return plan.add(replace(plan.trajectories[0], name=name, target_mm=self.near(cases.TARGET_MM)))

    def plan(self, change: Callable[[Plan], Plan]) -> None:
        change_plan(self.folder / "plan.json", change)

    def edit(self, **changes: object) -> None:
        self.plan(
            lambda plan: plan.edit(str(self.random.choice([one.name for one in plan.trajectories])), **changes)
        )

    def landmarks(self) -> Landmarks:
        middle = self.near(np.array([0.5, 0.0, 22.0]))
        return Landmarks(*(middle + off for off in ([0.0, -12.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 40.0])))

    def limits(self) -> None:
        stated = {
            "longest_path_mm": self.random.uniform(60.0, 90.0),
            "least_trajectory_distance_mm": self.random.uniform(1.0, 3.0),
            "tolerance_mm": float(self.random.integers(1, 3)),
        }
        (self.folder / "limits.json").write_text(
            json.dumps({"format": "ronnaplan.limits", "version": 1, **stated})
        )

    def markers(self) -> None:
        known = read_fiducials(self.folder / "fiducials.json")
        first = known.fiducials[0].model_dump() | {
            "center": self.near(np.array(known.fiducials[0].center)).tolist()
        }
        moved = known.model_dump() | {"fiducials": [first, *(one.model_dump() for one in known.fiducials[1:])]}
        (self.folder / "fiducials.json").write_text(to_json(type(known).model_validate(moved)))


def told(judged: Judgement, plan: Plan) -> str:
    measured = [judged.measures] if judged.measures else []
    return f"{measures_document(plan, measured, judged.verdicts)}{judged.problem}{judged.doubts}"


def in_brief(judged: Judgement) -> tuple[object, ...]:
    """What a list says of a trajectory."""
    near = [verdict for verdict in judged.verdicts if is_near(verdict)]
    return judged.broken, near, judged.doubts, judged.problem


@few_or_all("changes", 24, 40)
def test_what_is_kept_after_other_hands_changes_is_what_would_be_judged_anew(tmp_path: Path, changes: int) -> None:
    hand = OtherHand(cases.write_case(tmp_path))
    hand.limits()
    files = replace(CaseFiles.of_folder(tmp_path), limits=tmp_path / "limits.json")
    case = OpenCase(cases.volume(), files)
    kept = glances = 0
    for number in range(changes):
        hand.random.choice(np.array(hand.changes, dtype=object))()
        case.look_again()
        kept += sum(case.surroundings.knows(one, case.plan) for one in case.plan.trajectories)
        rules, theirs = Rules(read_limits(tmp_path / "limits.json")), read_plan(tmp_path / "plan.json")
        documents = read_fiducials(files.fiducials), read_registration(files.registration)  # type: ignore[arg-type]
        anew = Surroundings(case.surroundings.terrain, rules, *documents)
        glanced = case.surroundings.glance(case.plan)
        for mine, one, glance in zip(case.plan.trajectories, theirs.trajectories, glanced, strict=True):
            assert told(case.judge(mine), case.plan) == told(anew.judge(one, theirs), theirs), (SEED, number)
            if glance is not None:
                assert in_brief(glance) == in_brief(case.judge(mine)), (SEED, number)
                glances += 1
    assert kept > changes  # of three a change
    assert glances == kept
