"""The formats in which a robot is given its points; the command's help names them without loading what writes them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Final


class RobotFormat(StrEnum):
    """What `ronnaplan.documents.robot_points.export_points` writes."""

    JSON = "json"
    CSV = "csv"
    ROS = "ros"
    """YAML of geometry_msgs/PoseWithCovarianceStamped."""
    KRL = "krl"
    """A data list of a KUKA's controller."""


ENDINGS: Final[Mapping[RobotFormat, tuple[str, ...]]] = {RobotFormat.KRL: (".dat",)}
"""What files must be called where what reads them goes by the name."""
