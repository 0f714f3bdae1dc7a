"""Documents of markers and registrations that tests take apart."""

import numpy as np

from ronnaplan.documents.fiducials import FiducialsDocument, Source
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.documents.registration_made import registration_document
from ronnaplan.geometry import Points
from ronnaplan.registration.marker_registration import register_markers
from tests.registration import scene

SOURCE = Source(study_instance_uid="1.2.3", frame_of_reference_uid=scene.CT.uid)
TARGETS = Points(np.array([[10.0, -5, -20], [0, 0, 0]]), np.zeros((2, 3, 3)), ("left target", "center"), scene.CT)


def registered() -> RegistrationDocument:
    found = register_markers(scene.ct_points(), scene.readings(), sigma_ct_mm=0.1)
    return registration_document(found, SOURCE, TARGETS)


def refused() -> RegistrationDocument:
    square = np.array([[60.0, 0, 0], [0, 60, 0], [-60, 0, 0], [0, -60, 0]])
    small = np.tile(0.01 * np.eye(3), (4, 1, 1))
    ct = Points(square, small, ("A", "B", "C", "D"), scene.CT)
    ots = Points(square @ scene.TURN.T + scene.SHIFT, small, ("1", "2", "3", "4"), scene.OTS)
    return registration_document(register_markers(ct, ots, sigma_ct_mm=0.1), SOURCE)


def fiducials() -> FiducialsDocument:
    entries = [
        {
            "label": f"F{k + 1}",
            "center": place.tolist(),
            "covariance": (1e-4 * np.eye(3)).tolist(),
            "diameter_mm": 11.5,
            "contrast_hu": 900.0,
        }
        for k, place in enumerate(scene.HEAD / 3)
    ]
    return FiducialsDocument.model_validate(
        {
            "format": "ronnaplan.fiducials",
            "version": 1,
            "coordinate_system": "LPS",
            "unit": "mm",
            "source": SOURCE.model_dump(),
            "marker": {"diameter_mm": 11.5},
            "fiducials": entries,
            "software": {"name": "ronnaplan", "version": "0"},
        }
    )
