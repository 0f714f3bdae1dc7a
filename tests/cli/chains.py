"""A `chain.json` of a robot that was parked somewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def parked_chain(source: dict[str, Any], robot_from_ct: ArrayLike) -> dict[str, Any]:
    """Return the document of a chain (4, 4) in mm, measured to micrometres, on the CT that ``source`` names."""
    return {
        **{
            "format": "ronnaplan.chain",
            "version": 1,
            "unit": "mm",
            "way": "stereo",
            "middle": [0, 0, 0],
            "shares": [],
        },
        "source": source,
        "robot_from_ct": {"matrix": np.asarray(robot_from_ct).tolist(), "covariance": (1e-6 * np.eye(6)).tolist()},
        "software": {"name": "ronnaplan", "version": "0.2.0"},
    }
