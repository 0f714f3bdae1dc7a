# %% [markdown]
# # Batches
#
# `ronnaplan localize` takes several scans, or with `--all-series` every usable series below a folder; it goes on after a
# bad one and writes a summary. Here the second scan is missing:
#
#     ronnaplan localize data/synthetic_ct data/missing --diameter 11.5 --expected 6 -o results
#
# The exit status is the worst of all scans (0 done, 1 unusable, 3 refused). `results` is a new folder: one that has an earlier
# run's results is refused, for they would pass for this one's.

# %%
import shlex

from ronnaplan.cli import main

command = "localize data/synthetic_ct data/missing --diameter 11.5 --expected 6 -o results"
print("exit status", main(shlex.split(command)))  # as the shell runs it

# %% [markdown]
# Markers of several sizes: `--diameter 11.5 --diameter 10`. The summary tells how many there are of each; its columns are
# explained in [tables](../tables.md#summarycsv-of-several-scans).

# %%
import csv
from pathlib import Path

print(*sorted(path.name for path in Path("results").iterdir()), sep="\n")
for scan in csv.DictReader((Path("results") / "summary.csv").read_text().splitlines()):
    print("", *(f"{column}: {value}" for column, value in scan.items() if value), sep="\n")

# %% [markdown]
# From Python it is a loop; every result says by `source.series_instance_uid` and `voxel_sha256` what it was made from.
