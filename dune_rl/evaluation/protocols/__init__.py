"""Evaluation protocols: runs of a fixed number of control steps, by the paper and by its published code."""
