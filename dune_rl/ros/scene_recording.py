"""A scene in one episode as messages: its clock, its fixed frames, and the topics of its agents."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.ros.agent_recording import AgentRecording
from dune_rl.ros.group_topics import GroupTopics
from dune_rl.ros.library import MessageSink
from dune_rl.sensors.sensor import Reading
from dune_rl.state.state import State

# Of each group: the readings of its agents, and the ranges of all beams of their planar LiDARs.
Sensed = Sequence[tuple[Mapping[str, Reading], Mapping[str, Reading]]]


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

    def sense(self) -> Sensed:
        """What the agents of all scenes sense now."""
        return [(topics.readings(), topics.scans()) for topics in self.groups]


class SceneRecording:
    """Writes the topics of all external agents of a scene into `sink`, from the start of an episode on."""

    def __init__(self, sink: MessageSink, topics: SimulationTopics, scene: int, time_ns: int = 0) -> None:
        self._sink, self._topics, self._scene = sink, topics, scene
        self._agents = [
            [
                AgentRecording(sink, group, scene * group.group.count + agent, topics.prefixes[name])
                for agent, name in enumerate(group.group.names)
            ]
            for group in topics.groups
        ]
        types = sink.types
        transforms = [
            types.transform(
                types.header(time_ns, topics.prefixes[name] + mount.parent),
                topics.prefixes[name] + mount.name,
                mount.position,
                mount.rotation,
            )
            for group in topics.groups
            for name in group.group.names
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
        for group, recordings in zip(self._topics.groups, self._agents, strict=True):
            ended = state.groups[group.group.name].done
            for agent, recording in enumerate(recordings):
                if recording.begun and not ended[self._scene * group.group.count + agent]:
                    action = actions[group.group.name][self._scene, agent]
                    recording.write_action(action, time_ns, as_twist=as_twist)

    def write_clock(self, time_ns: int) -> None:
        types = self._sink.types
        self._sink.write("/clock", types.make("rosgraph_msgs/Clock", clock=types.time(time_ns)), time_ns)

    def write_state(self, state: State, time_ns: int, sensed: Sensed) -> None:
        """Write what the agents see and are after a control step, or at the start."""
        for group, recordings, (readings, scans) in zip(
            self._topics.groups, self._agents, sensed, strict=True
        ):
            ended = state.groups[group.group.name].done
            for agent, recording in enumerate(recordings):
                if not ended[self._scene * group.group.count + agent]:
                    recording.write_state(state, time_ns, readings, scans)
