# %% [markdown]
# # Making phantoms
#
# `phantoms` scans a described head and writes a DICOM series with its truth. It shares no code with `ronnaplan`, so it can
# judge it, or any other program. Below one marker's surroundings are scanned; `ronnaplan phantom` makes whole heads.
# The full physics needs the extra `phantoms` (`python -m pip install ".[phantoms]"`).

# %%
from phantoms.patients import random_patient

patient = random_patient(7, kind="post with insert", count=5, thickness_mm=1.25)
marker = patient.scene.markers[0]
print(marker.label, marker.center_mm, marker.diameter_mm, "mm of", marker.material)
print(len(patient.scene.markers), "markers; patient.write(folder) writes the scan")

# %%
near = patient.around(marker.center_mm, 14, crop=True)  # the slices and pixels within 14 mm
voxels_hu = near.images()  # (slice, row, column), by the full physics
print("slices, rows, columns:", voxels_hu.shape)
print("from", voxels_hu.min(), "to", voxels_hu.max(), "HU, where a usual scale ends")

# %% [markdown]
# On the command line:
#
#     ronnaplan phantom --list
#     ronnaplan phantom patient-insert --scanner fast -o my_phantom
#     ronnaplan localize my_phantom --diameter 11.5 -o fiducials.json
#     ronnaplan phantom-check my_phantom --truth my_phantom/truth.json --diameter 11.5
#
# `my_phantom/truth.json` holds where every marker really is; `phantom-check` says how far off each was found, and whether
# that is stated. [Phantoms](../phantoms.md) has the scenes and the physics.
