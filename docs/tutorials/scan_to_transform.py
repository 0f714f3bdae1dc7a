# %% [markdown]
# # From a scan to a transform
#
# Read the scan that comes with the source (run this in the source's folder, or give `read_ct` another path), find its
# markers, pair them with a tracker's readings, register, see the error to expect, and write all of it to files. Every
# block below was run when this page was made. The tables need the extra `arrays` (`python -m pip install ".[arrays]"`).

# %%
from ronnaplan import find_markers, localize, read_ct, read_recording, register_markers

ct = read_ct("data/synthetic_ct")
ct

# %%
found = localize(ct, diameter_mm=11.5)
found.plot(ct)

# %% [markdown]
# With the scan the markers are shown on the head, too, where pyvista is installed (the extra `arrays` or `scene`): each with its
# ellipsoid, so many times enlarged as the title says, which points where the scan and what lies beside the marker leave its center
# least certain.
#
# Each marker has a place (LPS, mm) and the error to expect of it, a standard deviation along each axis. (`to_dataframe` needs
# pandas, which the extra `arrays` brings: [installation](../installation.md). `found[0]` needs nothing.) What looked like a
# marker and is none keeps its reason.

# %%
found.to_dataframe()[
    ["label", "x_mm", "y_mm", "z_mm", "sigma_x_mm", "sigma_z_mm", "diameter_mm"]
]

# %%
print(found[0])
for other in found.rejected[:3]:
    print(other)

# %% [markdown]
# The readings come in no order, with strays. `register_markers` pairs them with the scan's markers and registers, or refuses;
# `pairing.status` says which. To each marker's own error it adds `sigma_ct_mm`, 0.56 mm per axis unless you say otherwise: that
# is how far markers on skin move between scan and operation (bone screws: 0.1).

# %%
readings = find_markers(read_recording("data/synthetic_ct/readings.csv"))
readings

# %%
registered = register_markers(found.points, readings.points)
registered.pairing

# %%
registration = registered.registration
assert registration is not None, registered.pairing.reason  # the pairing was refused
registration.plot()

# %% [markdown]
# The two steps are also there one by one: `match_points` pairs arrays, `register_points` registers pairs
# ([registration](../registration.md)); give the latter `moving_frame=ct.frame`, so that it knows which scan it is of.
#
# The residuals tell how well the markers agree, not the error at a target. That is `tre_rms_mm`, at any point of the scan;
# `radius_95_mm` is how far off a target stays with a chance of 95 %. `tre_map` is the RMS error at every voxel; its
# `plot` shows the planes through a place. What `plot` returns is a matplotlib figure: `.savefig("error.png")` writes it.

# %%
from ronnaplan.registration import radius_95_mm

targets = [[-15.0, 5.0, 10.0], [0.0, 90.0, -50.0]]
print(registration.tre_rms_mm(targets).round(2), "mm RMS")
print(radius_95_mm(registration.tre(targets)).round(2), "mm hold 95 %")
error_map = registration.tre_map(ct)
error_map.plot(targets[0], found.centers)

# %% [markdown]
# ## To files
#
# The files are those that the commands write and read. The `.tfm` holds `ct_from_ots`, as ITK and Slicer want it
# ([3D Slicer](../howto/slicer.md)).

# %%
from ronnaplan import read_registration, write_as, write_fiducials, write_registration

write_fiducials("fiducials.json", found)
document = write_registration("registration.json", registered, found, targets)
write_as("ct_from_ots.tfm", document, "itk")
write_as("expected_error.nii.gz", document, "tre-map", ct="data/synthetic_ct")

read = read_registration("registration.json")
print("rotation:", read.pose.rotation.round(3).tolist())
print("translation:", read.pose.translation_mm.round(2), "mm")
read.tre_map(ct)

# %% [markdown]
# Scan and map go to other libraries and back (`to_sitk`, `to_nibabel`, `to_pyvista`, `to_xarray`):

# %%
import SimpleITK as sitk

sitk.WriteImage(ct.to_sitk(), "ct.nii.gz")
again = read_ct("ct.nii.gz")
print("the scan as NIfTI and back:", bool((again.voxels_hu == ct.voxels_hu).all()))

# %% [markdown]
# Markers of two sizes are found together: `localize(ct, diameter_mm=[11.5, 8.0])`. The size is not known?
# `ronnaplan.localization.sizes_seen(ct)` tells which balls are there:

# %%
from ronnaplan.localization import sizes_seen

print(*sizes_seen(ct), sep=", ")
