"""Gazebo models and worlds (SDF)."""
