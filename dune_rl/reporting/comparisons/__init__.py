"""Comparisons of methods that met the same episodes, whatever folders their evaluations are in."""
