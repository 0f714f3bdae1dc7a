"""One ball, fitted to the voxels about it: what it looks like, what it is judged by, and how its fit descends.

``theta`` (P,) is everywhere what `parameters` names, (N,) counts the voxels of a `neighbourhood`, and (C,) the
directions about a center of `cells`.
"""
