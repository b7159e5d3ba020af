"""Wheeled robots read from a URDF: differential, skid-steer and Ackermann steering."""
