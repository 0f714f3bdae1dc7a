# %% [markdown]
# # From tracker to robot
#
# A registration maps the scan into the tracker's frame. One moment at which the tracker sees the tool and the robot knows
# where its tool is takes it on to the robot's base. Every pose names its two frames and carries its covariance.

# %%
import numpy as np

from ronnaplan import register_points
from ronnaplan.geometry import Frame
from ronnaplan.pose import Pose
from ronnaplan.robot import Capture, robot_from_ct, robot_trajectory

CT, OTS, M, TCP, R = Frame("CT", "1.2.3"), Frame("OTS"), Frame("M"), Frame("TCP"), Frame("R")
markers = np.array([[60.0, 20, 40], [-55, 45, 30], [-20, -70, 55], [10, 35, 95], [70, -40, 30]])
turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
noise_mm = np.random.default_rng(3).normal(0.0, 0.3, markers.shape)
read = markers @ turn.T + [100.0, -50.0, -1500.0] + noise_mm
registration = register_points(
    markers, read, 0.3**2 * np.eye(3), moving_frame=CT, fixed_frame=OTS
)
registration


# %%
def pose(to: Frame, origin: Frame, place_mm: list[float], sd_rad: float, sd_mm: float) -> Pose:
    matrix = np.eye(4)
    matrix[:3, 3] = place_mm
    return Pose(matrix, np.diag(np.repeat([sd_rad**2, sd_mm**2], 3)), to, origin)


moment = Capture(
    ots_from_m=pose(OTS, M, [120.0, 30, -1400], 2e-4, 0.1),
    m_from_tcp=pose(M, TCP, [0.0, 0, 180], 2e-4, 0.1),
    robot_from_tcp=pose(R, TCP, [500.0, 0, 400], 1e-4, 0.05),
)
chain = robot_from_ct(registration.pose, moment)
path = robot_trajectory("left", [40.0, 30, 90], [10.0, 5, 20], chain, frame=CT)
print(path.target_mm.round(2), "mm in R is the target;", end=" ")
print(f"{path.lateral_sd_mm:.2f} mm standard deviation across the path there")

# %% [markdown]
# A pose of other frames is refused, so that no chain is joined the wrong way round:

# %%
try:
    robot_from_ct(registration.pose.inverse(), moment)
except Exception as error:
    print(error)
