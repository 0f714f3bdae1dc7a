from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.ct import SeriesSource
from ronnaplan.planning import Instrument, Landmarks, Plan, Ruler, Trajectory
from tests.documents.plans import ANGLE, CT, UID


@pytest.fixture
def plan() -> Plan:
    """Two trajectories, landmarks, and a history with a change taken back."""
    first = Trajectory("left, deep", np.array([10.5, -20.25, 80.1]), np.array([1.0, 2.0, 3.0]), CT)
    second = Trajectory(
        "=B", np.array([-30.0, 5, 70]), np.array([-5.0, 0, 10]), CT, Instrument("mine", 2.5, 190.0), "#00ff7f"
    )
    landmarks = Landmarks(np.array([0.0, -12, 0]), np.array([0.0, 12, 0]), np.array([0.0, 0, 40]))
    built = Plan(SeriesSource("1.2", "1.3", UID), "ab" * 32).add(first).add(second).with_landmarks(landmarks)
    built = built.add_ruler(Ruler("D1", np.array([[0.0, 0, 0], [3.0, 4, 0]]))).add_ruler(ANGLE)
    return built.edit("=B", notes="second choice").lock("=B").remove("left, deep").undo()
