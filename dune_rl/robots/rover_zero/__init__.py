"""Rover Zero, the paper's skid-steer platform."""
