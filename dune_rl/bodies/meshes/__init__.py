"""Meshes of bodies, made of simple solids by our own code."""
