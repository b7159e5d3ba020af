"""Differential and skid-steer robots read from a URDF."""
