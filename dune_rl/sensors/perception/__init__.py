"""What a robot makes of its own readings: tracks of what moves, and a map of what was seen."""
