"""Synthetic CT of phantom spheres with known centres. Imports nothing of ronnaplan."""
