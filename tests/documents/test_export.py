"""Exports say the same places in other tools' words."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.ct import SeriesSource
from ronnaplan.documents.export import export
from ronnaplan.documents.fiducials import fiducials_document
from ronnaplan.documents.reading import to_json
from ronnaplan.localization import Fiducial, Fiducials
from tests import cases

FIT = cases.ball_parameters(contrast=1000.0)
CENTERS = [[-23.55, 82.21, 775.14], [1.25, -2.5, 0.125]]


@pytest.fixture
def document(tmp_path: Path) -> Path:
    covariance = np.diag([1e-4, 4e-4, 9e-4])
    found = tuple(
        Fiducial(label, np.array(center), covariance, covariance, FIT, 0.9, 0.01)
        for label, center in zip(["F1", "=1+1"], CENTERS, strict=True)
    )
    path = tmp_path / "fiducials.json"
    path.write_text(to_json(fiducials_document(Fiducials(found, (), (11.5,), SeriesSource(), "00"))))
    return path


def test_markups_hold_what_slicers_schema_1_0_3_asks_for(document: Path) -> None:
    content = json.loads(export(document, "markups"))
    assert content["@schema"].endswith("markups-schema-v1.0.3.json#")
    (markup,) = content["markups"]
    assert markup["type"] == "Fiducial"
    assert markup["coordinateSystem"] == "LPS"
    assert markup["coordinateUnits"] == "mm"
    for number, (point, center) in enumerate(zip(markup["controlPoints"], CENTERS, strict=True), start=1):
        assert point["position"] == center
        assert point["id"] == str(number)
        assert len(point["orientation"]) == 9
        assert point["positionStatus"] == "defined"
        assert isinstance(point["selected"], bool)
        assert isinstance(point["locked"], bool)
        assert isinstance(point["visibility"], bool)
        assert isinstance(point["description"], str)
        assert "error 0.037 mm RMS" in point["description"]


def text(document: Path, kind: str) -> str:
    """What is exported as text."""
    written = export(document, kind)
    assert isinstance(written, str)
    return written


def test_the_table_holds_places_and_errors(document: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(text(document, "csv"))))
    assert [[float(row[axis]) for axis in "xyz"] for row in rows] == CENTERS
    assert [float(rows[0][f"sigma_{axis}"]) for axis in "xyz"] == [0.01, 0.02, 0.03]
    assert rows[1]["label"] == "'=1+1"
    assert [row["coordinate_system"] for row in rows] == ["LPS"] * len(CENTERS)


def test_no_cell_is_taken_for_a_formula(document: Path) -> None:
    content = json.loads(document.read_text())
    content["fiducials"][0]["flags"] = ["=1+1", "cut"]
    document.write_text(json.dumps(content))
    rows = list(csv.DictReader(io.StringIO(text(document, "csv"))))
    assert rows[0]["flags"] == "'=1+1 cut"


def test_an_empty_cell_is_empty_and_a_label_is_as_it_was(document: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(text(document, "csv"))))
    assert (rows[0]["label"], rows[0]["flags"], rows[0]["frame_of_reference_uid"]) == ("F1", "", "")
