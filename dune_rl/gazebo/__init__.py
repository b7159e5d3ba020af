"""Worlds, actors and robots as files for Gazebo: SDF, URDF and meshes."""
