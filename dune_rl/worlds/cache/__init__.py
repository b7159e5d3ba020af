"""Disk cache of worlds, and the background process that fills it."""
