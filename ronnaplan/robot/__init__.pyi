from .chain import Capture as Capture, robot_from_ct as robot_from_ct, to_frame as to_frame
from .hand_eye import calibrate_hand_eye as calibrate_hand_eye, with_tip as with_tip
from .hand_eye_found import HandEye as HandEye
from .orientation import (
    frame_of_three as frame_of_three,
    orientation_covariance as orientation_covariance,
    tool_orientation as tool_orientation,
    tool_pose as tool_pose,
)
from .pivot import PivotCalibration as PivotCalibration, calibrate_pivot as calibrate_pivot
from .recorded import (
    locate_tool as locate_tool,
    robot_pose as robot_pose,
    seen_tool as seen_tool,
    tool_poses as tool_poses,
)
from .stereo.calibration import (
    StereoCalibration as StereoCalibration,
    TcpCalibration as TcpCalibration,
    calibrate_on_board as calibrate_on_board,
    calibrate_tcp as calibrate_tcp,
)
from .stereo.camera import Camera as Camera, StereoRig as StereoRig
from .stereo.markers import (
    RobotRegistration as RobotRegistration,
    register_robot_markers as register_robot_markers,
    relocate as relocate,
)
from .stereo.robot_markers import RobotMarkers as RobotMarkers
from .stereo.sphere import StereoSphere as StereoSphere, locate_sphere as locate_sphere
from .trajectories import RobotTrajectory as RobotTrajectory, robot_trajectory as robot_trajectory
