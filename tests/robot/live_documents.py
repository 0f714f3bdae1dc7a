"""The documents of a live chain, as the commands would have written them."""

import json
from pathlib import Path

import numpy as np

from phantoms.live_room import LiveRoom
from phantoms.robot_session import M_SPHERES_MM
from ronnaplan.documents.chain import tracked_chain
from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration_made import registration_document
from ronnaplan.registration.marker_registration import register_markers
from ronnaplan.robot.live import LiveChain
from tests import cases


def write_documents(live: LiveChain, room: LiveRoom, folder: Path) -> None:
    """Write registration.json, chain.json and tool.json of the tutorial's case."""
    fiducials = cases.fiducials()
    found = register_markers(fiducials.points, live.head)
    registration = registration_document(found, fiducials.source)
    (folder / "registration.json").write_text(to_json(registration))
    middle = np.mean([pair.center for pair in registration.pairs], axis=0)
    chain = tracked_chain(registration.pose, live.capture, fiducials.source, middle)
    (folder / "chain.json").write_text(to_json(chain))
    tool = {"format": "ronnaplan.template", "version": 1, "unit": "mm", "name": "tool", "labels": list("ABCD")}
    (folder / "tool.json").write_text(json.dumps({**tool, "centers": M_SPHERES_MM.tolist()}))
