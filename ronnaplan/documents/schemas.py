"""The JSON Schema of every file that ronnaplan writes or reads, for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from ronnaplan.documents.chain import ChainDocument
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.fields import DocumentModel
from ronnaplan.documents.limits import LimitsDocument
from ronnaplan.documents.measures import MeasuresDocument
from ronnaplan.documents.phantom_check import PhantomCheckDocument
from ronnaplan.documents.placement import PlacementDocument
from ronnaplan.documents.plan import PlanDocument
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.documents.rig import RigDocument, SpheresDocument
from ronnaplan.documents.robot_points import RobotPointsDocument
from ronnaplan.documents.room import RoomDocument
from ronnaplan.documents.template import TemplateDocument
from ronnaplan.documents.tool import HandEyeDocument, PivotDocument
from ronnaplan.errors import UsageError

DOCUMENTS: Final[Mapping[str, type[DocumentModel]]] = {
    "fiducials": FiducialsDocument,
    "registration": RegistrationDocument,
    "plan": PlanDocument,
    "limits": LimitsDocument,
    "measures": MeasuresDocument,
    "template": TemplateDocument,
    "phantom_check": PhantomCheckDocument,
    "placement": PlacementDocument,
    "room": RoomDocument,
    "pivot": PivotDocument,
    "hand_eye": HandEyeDocument,
    "rig": RigDocument,
    "spheres": SpheresDocument,
    "chain": ChainDocument,
    "robot_points": RobotPointsDocument,
}


def schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of the document called ``name``; `UsageError` with the known names."""
    if name not in DOCUMENTS:
        raise UsageError(f"no document is called {name!r}; choose one of {', '.join(DOCUMENTS)}")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **DOCUMENTS[name].model_json_schema()}
