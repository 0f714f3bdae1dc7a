"""Hostile input at every border of the program: `scripts/fuzz` runs it at length, the tests in small.

A border is a class derived from `tests.fuzz.border.Border`, kept beside the tests of its room, with one line in
`tests.fuzz.borders.BORDERS`; `tests.ct.image_fuzzing` is an example. Both the script and the tests then run it.
"""
