# %% [markdown]
# # Which layout of markers?
#
# Two questions before anything is scanned: can the markers be told apart when a tracker sees them in no order, and what
# error do they leave at the target?

# %%
import numpy as np

from ronnaplan import describe_layout
from ronnaplan.registration import predict_tre

rng = np.random.default_rng(1)
square = np.array([[60.0, 0, 60], [0, 60, 60], [-60, 0, 60], [0, -60, 60]])
loose = square + rng.normal(0.0, 12.0, (4, 3))
row = np.array([[60.0, -30, 60], [58, -10, 61], [61, 12, 59], [60, 33, 60]])
spread = np.array([[60.0, 20, 40], [-55, 45, 30], [-20, -70, 55], [10, 35, 95]])

# %% [markdown]
# The nearest rival order is how far the markers are from fitting onto themselves in another order. A square is its own
# rival: no tracker can tell its corners apart, and the pairing is refused. `refusal_probability` says how often.

# %%
target = np.array([[5.0, 10.0, 0.0]])
error = (0.56**2 + 0.17**2) * np.eye(3)  # skin markers and tracker, per axis, mm^2
for name, markers in {"square": square, "moved square": loose, "row": row, "spread": spread}.items():
    layout = describe_layout(markers)
    expected = np.sqrt(np.trace(predict_tre(markers, error, target)[0]))
    print(
        f"{name:13s} rival {layout.rival_distance_mm:5.1f} mm away, refused {layout.refusal_probability():4.0%}, "
        f"error at the target {expected:.2f} mm RMS"
    )

# %% [markdown]
# So: no symmetry, no row, markers on all sides of the target, one of them far from the others' plane. With six markers
# instead of four:

# %%
six = np.vstack([spread, [[70.0, -40, 30]], [[-65, -15, 75]]])
print(f"{np.sqrt(np.trace(predict_tre(six, error, target)[0])):.2f} mm RMS")

# %% [markdown]
# The same at every voxel of a scan is a map. The markers' places are the scan's own coordinates: LPS, in mm (a viewer in RAS
# shows the first two with the other sign). `error` is what one marker adds on both sides, the scan's and the tracker's:
# one matrix for all, or one each. The map is written in any format that SimpleITK knows, and lies on the scan in any viewer.

# %%
import SimpleITK as sitk

from ronnaplan import read_ct
from ronnaplan.registration import predict_tre_map

ct = read_ct("data/synthetic_ct")
expected_mm = predict_tre_map(six[:5], error, ct)
sitk.WriteImage(expected_mm.to_sitk(), "expected_error.nii.gz")
expected_mm

# %%
at_target = sitk.ReadImage("expected_error.nii.gz").EvaluateAtPhysicalPoint(target[0].tolist())
print(
    f"{at_target:.2f} mm RMS in the map, {np.sqrt(np.trace(predict_tre(six[:5], error, target)[0])):.2f} mm computed there"
)

# %% [markdown]
# `ronnaplan plan place` chooses places on the scalp of a scan by the same figures ([planning](../planning.md)).
