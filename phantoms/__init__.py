"""Synthetic CT of phantom spheres with known centers. Imports nothing of ronnaplan.

A `scene` of `solids` is scanned, by the `scanner` or the `fast` renderer, as a `stack` of slices and written as a
DICOM `series` with its truth. An `examination` holds all of that; `library` and `patients` make them.
"""
