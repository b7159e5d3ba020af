"""Trajectories of actors through a world: planned from way-points, checked, and written to files."""
