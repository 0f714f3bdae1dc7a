# %% [markdown]
# # Which layout of markers?
#
# Two questions before anything is scanned: can the markers be told apart when a tracker sees them in no order, and what
# error do they leave at the target?

# %%
import numpy as np

from ronnaplan import describe_layout
from ronnaplan.registration import predict_tre, radius_95_mm

rng = np.random.default_rng(1)
square = np.array([[60.0, 0, 60], [0, 60, 60], [-60, 0, 60], [0, -60, 60]])
loose = square + rng.normal(0.0, 12.0, (4, 3))
row = np.array([[60.0, -30, 60], [58, -10, 61], [61, 12, 59], [60, 33, 60]])
spread = np.array([[60.0, 20, 40], [-55, 45, 30], [-20, -70, 55], [10, 35, 95]])

# %% [markdown]
# The nearest rival order is how far the markers are from fitting onto themselves in another order. A square is its own
# rival: no tracker can tell its corners apart, and the pairing is refused. `refusal_probability` says how often. A flat layout, or
# one that is alike on the left and the right, is its own mirror image (`mirror_distance_mm` is 0): nothing tells readings of it with
# a swapped axis.

# %%
target = np.array([[5.0, 10.0, 0.0]])
in_ct_mm, tracker_mm = 0.56, 0.17  # standard deviation per axis (markers on skin)
error = (in_ct_mm**2 + tracker_mm**2) * np.eye(3)  # variances add up, mm^2
layouts = {"square": square, "moved square": loose, "row": row, "spread": spread}
for name, markers in layouts.items():
    layout = describe_layout(markers)
    rms_mm = np.sqrt(np.trace(predict_tre(markers, error, target)[0]))
    refused = layout.refusal_probability()
    print(f"{name:13s} rival {layout.rival_distance_mm:5.1f} mm away, ", end="")
    print(f"refused {refused:4.0%}, error at the target {rms_mm:.2f} mm RMS")

# %% [markdown]
# RMS is the root of the mean square over all three axes. How far off the target stays with a chance of 95 % is another figure,
# `radius_95_mm` of the same covariance.
#
# So: no symmetry, no row, markers on all sides of the target, one of them far from the others' plane. With six markers
# instead of four:

# %%
six = np.vstack([spread, [[70.0, -40, 30]], [[-65, -15, 75]]])
covariance = predict_tre(six, error, target)[0]
rms_mm, radius_mm = np.sqrt(np.trace(covariance)), radius_95_mm(covariance)
print(f"{rms_mm:.2f} mm RMS, {radius_mm:.2f} mm hold 95 %")

# %% [markdown]
# The same at every voxel is a map. It needs no scan: any grid will do, here voxels of 4 mm about the head. The affine maps voxel
# indices (slice, row, column) to LPS mm. The markers' places are LPS, too (a viewer in RAS shows the first two with the other
# sign). `error` is one matrix for all markers, or one each, or a tuple of both sides (in CT, of the tracker). `plot` shows the
# map in the three planes through a place, here the target, with the markers before them, wherever they lie.

# %%
import SimpleITK as sitk

from ronnaplan import CTVolume
from ronnaplan.registration import predict_tre_map

affine = [[0, 0, 4, -100], [0, 4, 0, -120], [4, 0, 0, -80], [0, 0, 0, 1]]
grid = CTVolume.from_array(np.zeros((50, 60, 50), np.int16), affine)
expected_mm = predict_tre_map(six[:5], error, grid)
sitk.WriteImage(expected_mm.to_sitk(), "expected_error.nii.gz")
expected_mm.plot(target[0], six[:5])

# %% [markdown]
# The map is written in any format that SimpleITK knows, and lies where the markers are in any viewer. With a scan at hand, give
# `read_ct("data/synthetic_ct")` in the grid's place, or `CTVolume.from_sitk(image)`: then the map has the scan's voxels.

# %%
written = sitk.ReadImage("expected_error.nii.gz")
in_map_mm = written.EvaluateAtPhysicalPoint(target[0].tolist())
there_mm = np.sqrt(np.trace(predict_tre(six[:5], error, target)[0]))
print(f"{in_map_mm:.2f} mm RMS in the map, {there_mm:.2f} mm computed there")

# %% [markdown]
# `ronnaplan plan markers` chooses places on the scalp of a scan by the same figures ([planning](../planning.md)).
