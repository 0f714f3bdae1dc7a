"""One ball, fitted to the voxels about it: what it looks like, what it is judged by, and how its fit descends."""
