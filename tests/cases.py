"""A case on the committed synthetic CT: its markers as truth.json has them, a plan, and readings of the markers."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan.ct import CTVolume, read_ct
from ronnaplan.documents.fiducials import FORMAT, FiducialsDocument
from ronnaplan.documents.plan import write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.documents.registration_made import registration_document
from ronnaplan.geometry import FloatArray, Frame, Points
from ronnaplan.localization.fit.parameters import PARAMETERS
from ronnaplan.planning import Plan, Trajectory
from ronnaplan.registration.marker_registration import register_markers

CT = Path(__file__).resolve().parents[1] / "data" / "synthetic_ct"
TURN = Rotation.from_rotvec([0.3, -0.9, 0.5])
SHIFT_MM = np.array([80.0, -40.0, -1400.0])
ENTRY_MM, TARGET_MM = np.array([30.0, -20.0, 84.0]), np.array([10.0, 5.0, 20.0])


def ball_parameters(**known: float) -> FloatArray:
    """The parameters of a fitted ball in air, by name; what is not named is nought."""
    usual = {"radius": 5.75, "blur": 0.5, "width": 1.0, "shape": 0.5, "contrast": 1100.0, "background": -1000.0}
    return np.array([(usual | known).get(name, 0.0) for name in PARAMETERS])


@cache
def volume() -> CTVolume:
    return read_ct(CT)


@cache
def fiducials() -> FiducialsDocument:
    scan = volume()
    markers = json.loads((CT / "truth.json").read_text())["markers"]
    return FiducialsDocument.model_validate(
        {
            "format": FORMAT,
            "version": 1,
            "coordinate_system": "LPS",
            "unit": "mm",
            "source": {
                "series_instance_uid": scan.source.series_instance_uid,
                "frame_of_reference_uid": scan.source.frame_of_reference_uid,
                "voxel_sha256": scan.voxel_sha256,
            },
            "marker": {"diameter_mm": 11.5},
            "fiducials": [
                {
                    "label": f"F{number}",
                    "center": marker["center"],
                    "covariance": (1e-5 * np.eye(3)).tolist(),
                    "diameter_mm": 11.5,
                    "contrast_hu": 1100.0,
                }
                for number, marker in enumerate(markers, start=1)
            ],
            "rejected": [{"center": [0.0, 80.0, 10.0], "reason": "not round"}],
            "software": {"name": "ronnaplan", "version": "0"},
        }
    )


def plan() -> Plan:
    scan = volume()
    return Plan.of_scan(scan).add(Trajectory("left", ENTRY_MM, TARGET_MM, scan.frame))


def seen_mm() -> FloatArray:
    """The markers (N, 3) as a tracker sees them."""
    found: FloatArray = TURN.apply(fiducials().points.positions_mm) + SHIFT_MM
    return found


def readings() -> Points:
    seen = seen_mm()
    count = len(seen)
    return Points(
        seen, np.tile(0.17**2 * np.eye(3), (count, 1, 1)), tuple(map(str, range(1, count + 1))), Frame("OTS")
    )


def registration() -> RegistrationDocument:
    found = register_markers(fiducials().points, readings())
    return registration_document(found, fiducials().source)


def write_case(folder: Path) -> Path:
    """Write all three documents of the case."""
    (folder / "fiducials.json").write_text(to_json(fiducials()))
    (folder / "registration.json").write_text(to_json(registration()))
    write_plan(folder / "plan.json", plan())
    return folder


def write_readings(path: Path) -> Path:
    rows = [f"{number},{x},{y},{z}" for number, (x, y, z) in enumerate(seen_mm(), start=1)]
    path.write_text("\n".join(["label,x,y,z", *rows]) + "\n")
    return path


def write_label_map(path: Path, side: int = 2) -> Path:
    """Write a region of so many voxels a side about the middle of the scan, named like its file."""
    import SimpleITK

    scan, grid = volume(), volume().grid
    mask = np.zeros(scan.voxels_hu.shape, dtype=np.uint8)
    mask[60 : 60 + side, 128 : 128 + side, 128 : 128 + side] = 1
    image = SimpleITK.GetImageFromArray(mask)
    image.SetOrigin(grid.origins_mm[0].tolist())
    image.SetSpacing((grid.column_spacing_mm, grid.row_spacing_mm, float(grid.spacings_mm[0])))
    image.SetDirection(grid.axes.T.ravel().tolist())
    path.parent.mkdir(exist_ok=True)
    SimpleITK.WriteImage(image, str(path))
    return path
