"""Imitation of a driver, by its costs of all commands (DAgger)."""
