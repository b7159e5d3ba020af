"""Worlds from Gazebo models and worlds (SDF)."""
