"""Paths: splines through way-points, the agents that go along them, and their stops."""
