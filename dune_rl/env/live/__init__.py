"""The live view of a scene: a page in a browser, on this machine."""
