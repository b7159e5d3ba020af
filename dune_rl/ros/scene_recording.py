"""A scene in one episode as messages: its clock, its fixed frames, and the topics of its agents."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.ros.agent_recording import AgentRecording
from dune_rl.ros.group_topics import GroupTopics, Sensed
from dune_rl.ros.library import MessageSink
from dune_rl.state.state import State


@dataclass(frozen=True)
class SimulationTopics:
    """The topics of the external `groups`, and the namespaces of agents, such as `rover_0/`, by their names.

    One agent alone has none. With `repeat` an action is held for so many control steps between two messages.
    """

    groups: tuple[GroupTopics, ...]
    prefixes: Mapping[str, str]

    @classmethod
    def of(cls, simulation: VectorSimulation, repeat: int) -> Self:
        step_s = simulation.physics.control_step_s
        several = len(simulation.agents) > 1
        return cls(
            tuple(GroupTopics(group, step_s, repeat) for group in simulation.external),
            {name: f"{name}/" if several else "" for name in simulation.agents},
        )

    def sense(self) -> dict[str, Sensed]:
        """What the agents of all scenes sense now, by group."""
        return {topics.group.name: topics.sense() for topics in self.groups}


class SceneRecording:
    """Writes the topics of all external agents of a scene into `sink`, from the start of an episode on."""

    def __init__(self, sink: MessageSink, topics: SimulationTopics, scene: int, time_ns: int = 0) -> None:
        self._sink = sink
        self._agents: list[AgentRecording] = []
        types, transforms = sink.types, []
        for group in topics.groups:
            for row, name in enumerate(group.group.names, scene * group.group.count):
                prefix = topics.prefixes[name]
                self._agents.append(AgentRecording(sink, group, row, prefix))
                transforms += [
                    types.transform(
                        types.header(time_ns, prefix + mount.parent), prefix + mount.name, mount.pose
                    )
                    for mount in group.mounts
                ]
        message = types.make("tf2_msgs/TFMessage", transforms=transforms)
        sink.write("/tf_static", message, time_ns, latched=True)

    def write_actions(
        self, actions: Mapping[str, Array], state: State, time_ns: int, *, as_twist: bool = True
    ) -> None:
        """Write the actions (M, G, A) of each group, chosen at a time, of agents that go on in `state`.

        With `as_twist` also as `cmd_vel`.
        """
        for agent in self._agents:
            agent.write_action(actions, state, time_ns, as_twist=as_twist)

    def write_clock(self, time_ns: int) -> None:
        types = self._sink.types
        self._sink.write("/clock", types.make("rosgraph_msgs/Clock", clock=types.time(time_ns)), time_ns)

    def write_state(self, state: State, time_ns: int, sensed: Mapping[str, Sensed]) -> None:
        """Write what the agents see and are after a control step, or at the start."""
        for agent in self._agents:
            agent.write_state(state, time_ns, sensed)
