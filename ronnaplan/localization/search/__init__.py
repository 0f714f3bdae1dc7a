"""Where balls may be: seen in coarse copies and nearest voxels, before any is fitted."""
