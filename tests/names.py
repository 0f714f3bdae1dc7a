"""Names that a picture must show by the letter."""

ANY_NAME = "\u982d \uba38\ub9ac $\\x_{$"
"""Letters that matplotlib's own font lacks, of which it warns, and what it would take for a formula, and a bad one."""
