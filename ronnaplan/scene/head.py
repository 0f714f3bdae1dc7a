"""All that a head is drawn from in 3-D, made of a scan by a process of its own: its voxels are worked on there, too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ronnaplan.ct import CTVolume
from ronnaplan.scene.shapes import Body
from ronnaplan.scene.vtk import NoGraphicsError, Workshop

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ronnaplan.scene.volume import Volume


@dataclass(frozen=True, eq=False)
class HeadParts:
    """The whole scan coarsely, skin and skull, and regions by name; ``wanting`` says why there are no surfaces."""

    volume: Volume | None = None
    surfaces: dict[str, Body] = field(default_factory=dict)
    regions: dict[str, Body] = field(default_factory=dict)
    wanting: str = ""


def head_parts(
    workshop: Workshop, scan: CTVolume, regions: Mapping[str, NDArray[np.bool_]], most_triangles: int
) -> HeadParts:
    """Have them made as the workshop's last task; each surface has at most so many triangles.

    ``regions`` are masks (K, J, I) of the scan.
    """
    try:
        with workshop:
            parts: HeadParts = workshop.answer("head", {"scan": scan, "regions": regions, "most": most_triangles})
    except NoGraphicsError as error:
        return HeadParts(wanting=str(error))
    return parts
