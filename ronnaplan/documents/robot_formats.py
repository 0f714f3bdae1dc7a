"""The formats in which a robot is given its points; the command's help names them without loading what writes them."""

from __future__ import annotations

from enum import StrEnum


class RobotFormat(StrEnum):
    """What `ronnaplan.documents.robot_points.export_points` writes."""

    JSON = "json"
    CSV = "csv"
    ROS = "ros"
    """YAML of geometry_msgs/PoseWithCovarianceStamped."""
    KRL = "krl"
    """A data list of a KUKA's controller."""
