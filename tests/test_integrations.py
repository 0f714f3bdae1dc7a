"""What lies in ``integrations`` fits the program that it is for."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ronnaplan.tracking import find_markers
from ronnaplan.tracking.recording import Recording, ToolReading

HOME = Path(__file__).resolve().parents[1] / "integrations"


def test_the_transforms_that_plus_is_told_to_send_are_in_one_coordinate_system() -> None:
    """A stream of poses in two of them is refused, or shown as if all were the tracker's."""
    root = ElementTree.parse(HOME / "plus" / "polaris.xml").getroot()
    names = [one.attrib["Name"] for one in root.iter("Transform")]
    poses = [np.eye(4), np.eye(4)]
    poses[1][:3, 3] = (100.0, 0.0, 0.0)
    told = tuple(ToolReading(k, name, pose) for k in range(20) for name, pose in zip(names, poses, strict=True))
    assert set(find_markers(Recording("plus", tools=told)).points.labels) == set(names)
