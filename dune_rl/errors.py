"""The one family of errors that a user can cause and mend."""


class DuneError(Exception):
    """A fault whose message says what to do about it; command lines print it and exit with 2."""


class ConfigError(DuneError):
    """Settings that cannot be: every fault found, one per line."""


class WorldError(DuneError):
    """A world that cannot give what is asked of it, such as a spawn with a path to a goal."""


class RegistryError(DuneError):
    """A part of a user's package or program that cannot be used: what is wrong with it, and where it is."""


class RobotError(DuneError):
    """A robot's description that cannot be used: what is wrong where, and how to mend it."""


class CheckpointError(DuneError):
    """A checkpoint that is missing, damaged, or made for another environment."""


class PhysicsError(DuneError):
    """A scene that the physics engine refuses, or an engine that is not installed."""


class DuneWarning(UserWarning):
    """Base of what users are warned of, in words that need no place in our code."""
