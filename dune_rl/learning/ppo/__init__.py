"""Proximal policy optimisation (Schulman et al. 2017) with generalised advantage estimation."""
