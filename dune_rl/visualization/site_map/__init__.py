"""Maps of a world from above."""
