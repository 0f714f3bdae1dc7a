"""Whether a fitted ball is a marker, how sure its center is, and which of its voxels tell that (`crossed`, `rim`)."""
