"""Evaluations: policies of any kind on the same episodes, and folders that hold all about the results."""
