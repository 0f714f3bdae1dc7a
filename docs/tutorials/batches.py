# %% [markdown]
# # Batches
#
# `ronnaplan localize` takes several scans, or with `--all-series` every usable series below a folder; it goes on after a
# bad one and writes a summary. Here the second scan is missing.

# %%
from pathlib import Path

from ronnaplan.cli import main

status = main(
    ["localize", "data/synthetic_ct", "data/missing", "--diameter", "11.5", "--expected", "6", "-o", "results"]
)
print("exit status", status)

# %%
print(*sorted(path.name for path in Path("results").iterdir()), sep="\n")
print((Path("results") / "summary.csv").read_text())

# %% [markdown]
# From Python it is a loop; every result says by `source.series_instance_uid` and `voxel_sha256` what it was made from.
