"""Whether robot and tracker stand to each other as when the tool was calibrated, or which mistake explains it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ronnaplan.errors import RefusedError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import Capture
from ronnaplan.robot.misread import mistake_in
from ronnaplan.transforms import rigid

ELSEWHERE_MM, ELSEWHERE_DEG = 3.0, 1.0
"""Robot and tracker that have not been moved come nearer than this to where the tool's calibration had them."""
FAR = 10.0
"""So many times as far off nothing comes back there by chance where poses are read in another way."""
OTHER_UNITS_MM = {"cm": 10.0, "inches": 25.4, "tenths of a mm": 0.1}
"""Units in which a recording's places are not seen to be no mm; of metres they are."""


def elsewhere(capture: Capture, robot_from_ots: Pose) -> tuple[str, ...]:
    """Say that in ``capture`` R from OTS is not ``robot_from_ots``, as it was when the tool was calibrated.

    Nothing is said where it does. Raises `RefusedError` where a mistake in the poses explains it.
    """

    def stand(tracker: FloatArray, robot: FloatArray) -> bool:
        seen = replace(capture.ots_from_m, matrix=tracker[0])
        driven = replace(capture.robot_from_tcp, matrix=robot[0])
        shift_mm, turn_deg = replace(capture, ots_from_m=seen, robot_from_tcp=driven).moved_since(robot_from_ots)
        return shift_mm < ELSEWHERE_MM and turn_deg < ELSEWHERE_DEG

    tracker, robot = capture.ots_from_m.matrix[None], capture.robot_from_tcp.matrix[None]
    if stand(tracker, robot):
        return ()
    shift_mm, turn_deg = capture.moved_since(robot_from_ots)
    said = (
        f"robot and tracker stand {shift_mm:.0f} mm and {turn_deg:.1f} degrees otherwise to each other than in the "
        "hand-eye calibration"
    )
    far = shift_mm > FAR * ELSEWHERE_MM or turn_deg > FAR * ELSEWHERE_DEG
    if far and (misread := mistake_in(tracker, robot, stand)):
        raise RefusedError(f"{said}, and as in it if {misread}; turn them into matrices, or a quaternion, anew")
    if far and (unit := _other_unit(tracker, robot, stand)):
        raise RefusedError(f"{said}, and as in it if {unit}; give all in mm")
    if far and stand(robot, tracker):
        raise RefusedError(
            f"{said}, and as in it if the tracker's and the robot's poses change places, here or in that calibration; "
            "give each recording where it belongs, to `robot hand-eye`, too"
        )
    return (f"{said}: if neither was moved since, recordings are mixed up or not in mm",)


def _other_unit(tracker: FloatArray, robot: FloatArray, stand: Callable[[FloatArray, FloatArray], bool]) -> str:
    """Say in which unit the places of poses (N, 4, 4) would be as in the calibration; empty where they are in none."""
    for unit, length_mm in OTHER_UNITS_MM.items():
        seen, driven = (rigid(one[:, :3, :3], one[:, :3, 3] * length_mm) for one in (tracker, robot))
        for whose, poses in (
            ("the tracker's places are", (seen, robot)),
            ("the robot's places are", (tracker, driven)),
            ("the places of both are", (seen, driven)),
        ):
            if stand(*poses):
                return f"{whose} in {unit}"
    return ""
