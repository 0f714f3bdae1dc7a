# %% [markdown]
# # From a scan to a transform
#
# Read the scan that comes with the source, find its markers, pair them with a tracker's readings, register, and see the
# error to expect. Every block below was run when this page was made.

# %%
from ronnaplan import find_markers, localize, match_points, read_ct, read_recording, register_points

ct = read_ct("data/synthetic_ct")
ct

# %%
found = localize(ct, diameter_mm=11.5)
found.plot(ct)

# %% [markdown]
# Each marker has a place (LPS, mm) and the error to expect of it; what looked like a marker and is none keeps its reason.

# %%
found.to_dataframe()[["label", "x_mm", "y_mm", "z_mm", "error_x_mm", "error_z_mm", "diameter_mm"]]

# %%
for other in found.rejected[:3]:
    print(other.center_mm.round(1), other.reason)

# %% [markdown]
# The readings come in no order, with strays. `match_points` is right or refuses; `pairing.status` says which.

# %%
import numpy as np

readings = find_markers(read_recording("data/synthetic_ct/readings.csv")).points
skin = 0.56**2 * np.eye(3)  # how far markers on skin move between scan and operation, mm^2
errors = found.covariances + skin, readings.covariances_mm2
pairing = match_points(
    found.centers, readings.positions_mm, covariances_ct_mm2=errors[0], covariances_ots_mm2=errors[1]
)
pairing

# %%
ct_index, ots_index = pairing.pairs.T
registration = register_points(
    found.centers[ct_index], readings.positions_mm[ots_index], (errors[0][ct_index], errors[1][ots_index])
)
registration.plot()

# %% [markdown]
# The residuals tell how well the markers agree, not the error at a target. That is `tre_rms_mm`, at any point of the scan,
# and `tre_map` at all of them; the map goes to other libraries as the scan does.

# %%
print(registration.tre_rms_mm([[-15.0, 5.0, 10.0], [0.0, 90.0, -50.0]]).round(2), "mm RMS")
error_map = registration.tre_map(ct)
error_map

# %%
import SimpleITK as sitk

sitk.WriteImage(error_map.to_sitk(), "expected_error.nii.gz")
sitk.WriteImage(ct.to_sitk(), "ct.nii.gz")
again = read_ct("ct.nii.gz")
print("the scan as NIfTI and back:", bool((again.voxels_hu == ct.voxels_hu).all()))

# %% [markdown]
# Markers of two sizes are found together: `localize(ct, diameter_mm=[11.5, 8.0])`.
