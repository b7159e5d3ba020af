"""Evaluations as Minari datasets: what the agent observed and did in every step, for offline learning."""
