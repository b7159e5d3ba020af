"""Small environments, one sound and the others each wrong in one way, that show the checks can fail."""
