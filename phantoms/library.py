"""Ready-made scenes."""

from __future__ import annotations

from functools import reduce

from phantoms import parts
from phantoms.scene import Scene

DEMO_MARKERS = {
    "M1": (-0.62, -0.55, 0.56),
    "M2": (0.45, -0.72, 0.53),
    "M3": (0.86, 0.05, 0.50),
    "M4": (0.30, 0.62, 0.72),
    "M5": (-0.55, 0.70, 0.45),
    "M6": (-0.30, 0.10, 0.95),
}
DEMO_DECOYS = {
    "larger sphere": (-0.85, 0.15, 0.45),
    "cylinder": (0.05, -0.35, 0.93),
    "ellipsoid": (0.60, 0.35, 0.75),
    "capsule": (-0.75, -0.25, 0.62),
    "bare screw": (0.62, -0.38, 0.68),
}


def demo_head() -> Scene:
    """Return the scene of ``data/synthetic_ct``: six 11.5 mm markers on posts, five decoys, on a head."""
    markers = [parts.marker_on_post(label, parts.scalp_foot(at)) for label, at in DEMO_MARKERS.items()]
    decoys = [parts.decoy(kind, parts.scalp_foot(at)) for kind, at in DEMO_DECOYS.items()]
    scene = reduce(Scene.__add__, [parts.head(), *markers, *decoys])
    return Scene(scene.parts, scene.markers, scene.decoys, "demo head")
