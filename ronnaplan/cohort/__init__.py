"""Many series: found below roots, worked off on Dask, kept in an index, summed up in tables and a page."""
