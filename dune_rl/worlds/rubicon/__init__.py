"""A wooded hillside with rocks."""
