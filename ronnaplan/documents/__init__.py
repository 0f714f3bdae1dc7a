"""The files that carry results from one stage to the next, and the exporters to other tools' formats."""
