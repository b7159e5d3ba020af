"""The map of a site, from above."""
