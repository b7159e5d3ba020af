"""Disk cache of worlds, and the process that fills it ahead of their use."""
