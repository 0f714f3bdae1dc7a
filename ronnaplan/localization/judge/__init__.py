"""Whether a fitted ball is a marker, and how sure its center is."""
