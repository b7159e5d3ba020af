"""The state of one control step, and what it says of what is around each agent."""

from dune_rl.state.state import (
    Array,
    BatteryModel,
    ContactState,
    Counts,
    EnergyState,
    EpisodeState,
    Flags,
    GoalState,
    GroundQueries,
    GroupState,
    JointState,
    Motion,
    ProximityQueries,
    ScanQueries,
    State,
)

__all__ = [
    "Array",
    "BatteryModel",
    "ContactState",
    "Counts",
    "EnergyState",
    "EpisodeState",
    "Flags",
    "GoalState",
    "GroundQueries",
    "GroupState",
    "JointState",
    "Motion",
    "ProximityQueries",
    "ScanQueries",
    "State",
]
