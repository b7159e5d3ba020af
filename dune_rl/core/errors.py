"""Exceptions and warnings for faults that a user can correct."""


class DuneError(Exception):
    """Base of errors whose message states a remedy; command lines print it and exit with code 2."""


class ConfigError(DuneError):
    """Invalid settings; the message lists every fault, one per line."""


class WorldError(DuneError):
    """A world that cannot be built, or has no room for the task."""


class RegistryError(DuneError):
    """A part of a user's package or program that cannot be used: what is wrong with it, and where it is."""


class RobotError(DuneError):
    """A robot's description that cannot be used: what is wrong where, and how to mend it."""


class CheckpointError(DuneError):
    """A checkpoint that is missing, damaged, or made for another environment."""


class TrainingError(DuneError):
    """A training run that cannot go on."""


class DivergenceError(TrainingError):
    """A training run whose weights, losses or gradients are not finite any more."""


class PhysicsError(DuneError):
    """A scene that the physics engine refuses, or an engine that is not installed."""


class DuneWarning(UserWarning):
    """Base of warnings for users, which are printed without a source location."""
