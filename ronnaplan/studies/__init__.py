"""The Monte Carlo studies: their scenes, their runs on all cores or a cluster, their tables and plots."""
