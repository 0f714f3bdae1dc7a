"""What an optical tracker says of a phantom's markers: unordered points, strays among them, and the truth beside."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phantoms.scene import Scene
from phantoms.solids import FloatArray

READINGS_NAME = "readings.csv"
TRUTH_NAME = "readings_truth.json"
TRUTH_FORMAT = "phantoms.readings"


@dataclass(frozen=True)
class Tracker:
    """A tracker that looks at a patient: ``ots_from_ct`` (4, 4), noise per axis, and what shines but is no marker.

    ``strays_mm`` (S, 3) are places of its own frame in mm; the first is there in every frame, of the others each frame
    sees one.
    """

    ots_from_ct: FloatArray
    strays_mm: FloatArray
    sigma_mm: float = 0.17
    skin_sigma_mm: float = 0.5
    """How far each marker has moved with the skin since the scan, per axis."""
    frames: int = 20
    hidden_share: float = 0.05
    """Share of the frames in which a marker is not seen."""


def write_readings(folder: Path, scene: Scene, tracker: Tracker, seed: int) -> None:
    """Write the readings of the scene's markers, and their truth, to ``folder``; the same seed gives the same bytes."""
    centers_mm = np.array([marker.center_mm for marker in scene.markers])
    places_mm = centers_mm @ tracker.ots_from_ct[:3, :3].T + tracker.ots_from_ct[:3, 3]
    rng = np.random.default_rng(seed)
    places_mm += rng.normal(0.0, tracker.skin_sigma_mm, places_mm.shape)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["frame", "x", "y", "z"])
    for frame in range(tracker.frames):
        seen = places_mm[rng.random(len(places_mm)) >= tracker.hidden_share]
        others = tracker.strays_mm[:1], tracker.strays_mm[1:][rng.integers(len(tracker.strays_mm) - 1)][None]
        points = rng.permutation(np.concatenate([seen, *others]))
        noisy = points + rng.normal(0.0, tracker.sigma_mm, points.shape)
        table.writerows([frame, *(f"{value:.3f}" for value in point)] for point in noisy)
    (folder / READINGS_NAME).write_text(text.getvalue(), encoding="utf-8", newline="")
    truth = {
        "format": TRUTH_FORMAT,
        "version": 1,
        "unit": "mm",
        "sigma_mm": tracker.sigma_mm,
        "skin_sigma_mm": tracker.skin_sigma_mm,
        "ots_from_ct": np.round(tracker.ots_from_ct, 12).tolist(),
        "markers": [
            {"label": marker.label, "center": np.round(place, 6).tolist()}
            for marker, place in zip(scene.markers, places_mm, strict=True)
        ],
        "strays": tracker.strays_mm.tolist(),
    }
    (folder / TRUTH_NAME).write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8", newline="")
