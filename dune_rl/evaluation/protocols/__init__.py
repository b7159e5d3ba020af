"""Evaluation protocols: runs of a fixed number of control steps, by the paper and by its published code."""

from dune_rl.evaluation.protocols.settings import (
    DEFAULT_RUN_STEPS,
    DEFAULT_RUNS,
    EPISODES_PER_RUN,
    check_protocol_overrides,
    settings_of_protocol,
)

__all__ = [
    "DEFAULT_RUNS",
    "DEFAULT_RUN_STEPS",
    "EPISODES_PER_RUN",
    "check_protocol_overrides",
    "settings_of_protocol",
]
