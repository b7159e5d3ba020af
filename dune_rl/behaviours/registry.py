"""Registry of behaviours: built-in ones, those of installed packages, and those registered at run time."""

from typing import Any, Protocol

from numpy.typing import NDArray

from dune_rl.core.registry import Registry
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Flags
from dune_rl.state.state import GroupState, State


class Behaviour(Protocol):
    """What decides for N agents of a group that no policy of the user drives.

    A behaviour that has `bind` is bound to its group first (`BoundBehaviour`). Where its class has the
    attribute `reads_sensors`, and it is True, the group observes as an external one does. The attribute
    `motion_models` of a class has the models of motion of the bodies that it can move; without it, all.
    """

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Clear the history of the agents in `mask` (N,), whose episodes begin."""
        ...

    def act(self, state: State, group: GroupState) -> NDArray[Any]:
        """The actions (N, A) of the agents for the next control step."""
        ...


class BehaviourSettings(Settings):
    """Settings of a behaviour; `name` selects the settings class when a file is read."""

    name: str


BEHAVIOURS: Registry[Behaviour] = Registry(
    "behaviour",
    "dune_rl.behaviours.registry:BEHAVIOURS",
    own={
        "crossing": "dune_rl.behaviours.pursuit:Crossing",
        "dwa": "dune_rl.behaviours.drivers.dwa:Dwa",
        "dwa_oracle": "dune_rl.behaviours.drivers.dwa_oracle:DwaOracle",
        "flee": "dune_rl.behaviours.pursuit:Flee",
        "follow": "dune_rl.behaviours.pursuit:Follow",
        "go_to_goal": "dune_rl.behaviours.go_to_goal:GoToGoal",
        "herd": "dune_rl.behaviours.herd:Herd",
        "mppi": "dune_rl.behaviours.drivers.mppi:Mppi",
        "oracle": "dune_rl.behaviours.drivers.oracle:Oracle",
        "orca": "dune_rl.behaviours.people:Orca",
        "patrol": "dune_rl.behaviours.destinations:Patrol",
        "planner": "dune_rl.behaviours.drivers.planner:Planner",
        "random_waypoint": "dune_rl.behaviours.destinations:RandomWaypoint",
        "social_force": "dune_rl.behaviours.people:SocialForce",
    },
    base=BehaviourSettings,
    product=Behaviour,
    form="a class with reset and act, made with (num_rows), or a function that returns such an object",
    function_leading=("num_rows",),
    class_leading=("num_rows",),
)
