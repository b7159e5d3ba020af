"""The state of one control step, and what it says of what is around each agent."""

from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.state.body_description import BodyDescription
from dune_rl.state.state import (
    BatteryModel,
    ContactState,
    EnergyState,
    EpisodeState,
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
    "BodyDescription",
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
