"""Intervals, paired tests and tables of measured episodes; no simulation, no PyTorch."""
