"""What a hand-eye calibration found, and why it may be wrong."""

from __future__ import annotations

from dataclasses import dataclass

from ronnaplan.pose import Pose
from ronnaplan.robot.by_pose import UNSUSPECTED, Suspicion
from ronnaplan.robot.hand_eye_late import told_late
from ronnaplan.robot.hand_eye_step import Step
from ronnaplan.text import counted

SWAPPED = 1.5
"""The tracker's errors are least at its spheres; found larger at M than at the TCP by this, M may be the robot's."""
SURELY_BY_POSE = 0.99
"""So likely errors by the robot's pose have to be to be told; how likely they are counts in the covariance anyhow."""


@dataclass(frozen=True, repr=False)
class HandEye:
    """The two constant poses, their covariance, and how well the recorded poses agree."""

    m_from_tcp: Pose
    robot_from_ots: Pose
    """Both are without the errors of the poses seen; where these drift, as in the middle of the poses that count."""
    rotation_rms_deg: float
    """RMS over the poses of the angle left."""
    translation_rms_mm: float
    """At M's origin."""
    tcp_rms_mm: float
    """What is left at the TCP."""
    by_pose: Suspicion = UNSUSPECTED
    """Whether the errors depend on the robot's pose (`by_pose`); its scale is a part of the tracker's distances."""
    far: tuple[int, ...] = ()
    """Which poses are far off what the others say (`hand_eye_start.far_off`), and were counted as they are."""
    out_of_step: bool = False
    """Whether the poses fit far better with those of the robot one earlier, or one later."""
    step: Step | None = None
    """From which pose on robot and tracker, or M and TCP, stand otherwise to each other than before."""
    repeated: int = 0
    """How many poses were left out, as the tracker's were earlier ones to the last digit."""
    rested: int = 0
    """How many were left out, as the robot stood still and others of that rest count (`rests`)."""

    def __repr__(self) -> str:
        doubted = f", {counted(len(self.doubts), 'doubt')}" if self.doubts else ""
        left = f"{self.rotation_rms_deg:.3g} degrees and {self.tcp_rms_mm:.3g} mm RMS at the TCP left{doubted}"
        return f"HandEye({self.m_from_tcp!r}, {self.robot_from_ots!r}, {left})"

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why it may be wrong: a tool that was hidden, tracker and robot exchanged, or poses not of one moment."""
        told = []
        if self.repeated:
            told.append(
                f"poses of the tracker that are an earlier one to the last digit were left out, {self.repeated} in "
                "all: look whether the tool was hidden then"
            )
        late = self.by_pose.of_delay > SURELY_BY_POSE
        if self.translation_rms_mm > SWAPPED * self.tcp_rms_mm and not late:
            told.append(
                f"the poses of M err by {self.translation_rms_mm:.3f} mm RMS at its origin and by "
                f"{self.tcp_rms_mm:.3f} mm at the TCP, as if the TCP were what the tracker sees: check which recording "
                "is the tracker's and which the robot's"
            )
        if late:
            told.append(
                f"the poses fit far better if {told_late(self.by_pose.delay)} (standard error "
                f"{self.by_pose.delay_sd:.3f}); no number of poses averages that out, and the stated errors count it: "
                "record both at the same moments, or stand still for each"
            )
        elif self.out_of_step:
            told.append(
                "the poses of robot and tracker fit far better one apart, as if they were not of the same moments: "
                "check how they are numbered and by how much either is late, or stand still for each"
            )
        if self.by_pose.of_scale > SURELY_BY_POSE:
            longer = "too long" if self.by_pose.scale > 0 else "too short"
            told.append(
                f"the poses fit far better if the tracker's distances are {abs(self.by_pose.scale):.2%} {longer} "
                f"(standard error {self.by_pose.scale_sd:.2%}), or the robot's as much the other way; no number of "
                "poses averages that out, and the stated errors count it: check the tracker's calibration, its tool's "
                "geometry and the robot's lengths and joints, and record anew"
            )
        elif self.by_pose.of_any > SURELY_BY_POSE and not late:
            told.append(
                "the errors depend on the robot's pose, as where its joints' zeros or its tool's data are off, it "
                "bends under its weight, or the tracker's distances are wrong; no number of poses averages that out, "
                "and the stated errors count it: check these and record anew"
            )
        return tuple(told)
