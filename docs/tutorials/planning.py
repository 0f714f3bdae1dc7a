# %% [markdown]
# # Planning
#
# A trajectory is two points of the scan and an instrument. It is measured in the scan itself: where it crosses skin and
# skull, at what angle, and what the registration's error means for it. `plan.plot(ct)` shows it from three sides and, where
# pyvista is installed (the extra `arrays` or `scene`), within the head.

# %%
import numpy as np

from ronnaplan import Plan, Trajectory, read_ct
from ronnaplan.planning import INSTRUMENTS, Head, Limits, judge, measure

ct = read_ct("data/synthetic_ct")
# LPS: the patient's left is positive
entries_mm = np.array([[35.0, -25.0, 78.0], [-40.0, -20.0, 75.0]])
targets_mm = np.array([[15.0, 5.0, 10.0], [-15.0, 5.0, 10.0]])
electrode = INSTRUMENTS["SEEG electrode"]
left = Trajectory("left", entries_mm[0], targets_mm[0], ct.frame, electrode)
right = Trajectory("right", entries_mm[1], targets_mm[1], ct.frame, electrode)
plan = Plan.of_scan(ct).add(left).add(right)
plan.plot(ct)

# %%
measured = measure(left, Head.of(ct), others=plan.trajectories)
others_mm = [round(one.distance_mm, 1) for one in measured.spacings]
print(f"{left.length_mm:.1f} mm long; other paths at", others_mm, "mm")

# %% [markdown]
# Limits are judged one by one; a value that cannot be measured does not pass.

# %%
for verdict in judge(measured, Limits(longest_path_mm=80.0, greatest_skull_angle_deg=40.0)):
    judged = "passes" if verdict.passes else "FAILS "
    print(judged, verdict.measure, verdict.value, verdict.unit, verdict.remark)

# %% [markdown]
# A plan is never changed in place, and every step can be taken back:

# %%
shorter = plan.edit("left", target_mm=left.at_depth(60.0))
print(round(shorter.trajectory("left").length_mm, 1), "mm;", shorter.undo())
