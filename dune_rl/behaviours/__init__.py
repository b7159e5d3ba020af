"""Behaviours: what moves the agents that no policy of the user drives."""
