"""A frame is found among other markers by its distances, or refused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.documents.template import read_template
from ronnaplan.errors import RefusedError, RonnaplanError
from ronnaplan.localization import Fiducial, Template
from ronnaplan.localization.template import match_template
from tests import cases

SHIFT = np.array([5.0, 6.0, 7.0])
FRAME = np.array([[0.0, 0, 0], [40, 0, 0], [0, 55, 0], [-30, -20, 5]])
DISTANCES = np.linalg.norm(FRAME[:, np.newaxis] - FRAME, axis=-1)
TEMPLATE = Template("frame", ("A", "B", "C", "D"), DISTANCES)


def markers(points: np.ndarray) -> list[Fiducial]:
    fit = cases.ball_parameters()
    covariance = np.eye(3) * 1e-5
    return [Fiducial(f"F{n}", point, covariance, covariance, fit, 0.9, 0.01) for n, point in enumerate(points, 1)]


def test_the_frame_is_labelled_and_the_rest_rejected() -> None:
    order = [2, 0, 3, 1]
    points = np.vstack([[[90.0, 80, 10]], FRAME[order] + SHIFT, [[-70.0, 10, 30]]])
    found, others = match_template(TEMPLATE, markers(points))
    assert [one.label for one in found] == ["A", "B", "C", "D"]
    assert np.array([one.center_mm for one in found]) == pytest.approx(FRAME + SHIFT)
    assert [one.center_mm.tolist() for one in others] == [[90.0, 80, 10], [-70.0, 10, 30]]
    assert others[0].test == "template"


def test_a_frame_that_is_not_there_or_there_twice_is_refused() -> None:
    with pytest.raises(RefusedError, match="of 3 markers none have the distances"):
        match_template(TEMPLATE, markers(FRAME[:3]))
    bent = FRAME.copy()
    bent[3, 0] -= 2.0
    with pytest.raises(RefusedError, match="none have"):
        match_template(TEMPLATE, markers(bent))
    with pytest.raises(RefusedError, match="2 choices"):
        match_template(TEMPLATE, markers(np.vstack([FRAME, FRAME + 200.0])))


@pytest.mark.parametrize("flat", [False, True])
def test_a_frame_whose_places_are_stated_is_told_from_its_mirror_image(tmp_path: Path, flat: bool) -> None:
    centers = FRAME * [1, 1, 0] if flat else FRAME
    header = {
        "format": "ronnaplan.template",
        "version": 1,
        "unit": "mm",
        "name": "frame",
        "labels": ["A", "B", "C", "D"],
    }
    path = tmp_path / "frame.json"
    path.write_text(json.dumps({**header, "centers": centers.tolist()}))
    stated = read_template(path)
    turned = centers[:, [1, 2, 0]] + SHIFT
    seen = turned + np.random.default_rng(1).normal(0.0, 0.1, (4, 3))
    assert len(match_template(stated, markers(seen))[0]) == 4
    mirrored = markers(seen * [-1, 1, 1])
    if flat:
        assert len(match_template(stated, mirrored)[0]) == 4
        return
    assert len(match_template(TEMPLATE, mirrored)[0]) == 4
    with pytest.raises(RefusedError, match="mirror image of template 'frame'"):
        match_template(stated, mirrored)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"labels": ("A", "B", "C")}, r"have shape \(4, 4\); expected \(3, 3\) in mm"),
        ({"labels": "ABCD"}, "str is given for the labels of a template"),
        ({"distances_mm": np.triu(DISTANCES)}, "not finite and symmetric"),
        ({"distances_mm": DISTANCES + 1.0}, "with a zero diagonal"),
        ({"distances_mm": np.where(DISTANCES > 0, np.nan, 0.0)}, "not finite and symmetric"),
        ({"distances_mm": "far"}, "the distances of template 'frame' are not numbers"),
        ({"centers_mm": np.eye(3)}, "3 centers for 4 labels"),
    ],
)
def test_a_template_made_in_python_holds_a_distance_between_each_two_markers(
    changes: dict[str, Any], says: str
) -> None:
    """One of fewer labels was found by the first distances, and only those below the diagonal were looked at."""
    with pytest.raises(RonnaplanError, match=says):
        dataclasses.replace(TEMPLATE, **changes)


def test_a_template_made_of_lists_is_the_same() -> None:
    listed = Template("frame", ["A", "B", "C", "D"], DISTANCES.tolist())  # type: ignore[arg-type]
    assert listed.labels == TEMPLATE.labels
    np.testing.assert_array_equal(listed.distances_mm, DISTANCES)
    assert repr(listed) == "Template(frame: A, B, C, D, distances right within 0.5 mm)"
