"""The rubicon world: a wooded hillside with rocks."""
