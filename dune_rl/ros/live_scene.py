"""A scene on live topics: what its robots sense goes out, commands and goals come in."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dune_rl.core.errors import ConfigError
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.ros.dds import Participant, Subscription
from dune_rl.ros.library import full_name
from dune_rl.ros.scene_recording import SceneRecording, SimulationTopics
from dune_rl.ros.settings import LiveConf
from dune_rl.ros.times import time_ns_of
from dune_rl.ros.transforms import MAP
from dune_rl.ros.velocity_commands import TWIST, TWIST_STAMPED, VelocityCommands
from dune_rl.tasks.task import DIVERGED, Task, TaskConf

_POSE, _EMPTY = full_name("geometry_msgs/PoseStamped"), full_name("std_msgs/Empty")
_RESET = "/reset"
# A simulation that is so far behind its clock does not catch up [s].
_MOST_LAG_S = 0.25
# How often it is checked what others publish [s].
_CHECK_S = 1.0

Report = Callable[[str], None]


@dataclass(frozen=True)
class LiveSummary:
    """How a scene ran: control steps, their time and the real time [s], commands, and episodes that began."""

    steps: int
    simulated_s: float
    took_s: float
    commands: int
    episodes: int

    def __str__(self) -> str:
        rate, factor = (each / max(self.took_s, 1e-9) for each in (self.steps, self.simulated_s))
        return (
            f"{self.simulated_s:.1f} s simulated in {self.took_s:.1f} s ({factor:.2f} times real time, "
            f"{rate:.0f} steps a second), {self.commands:,} commands, episodes: {self.episodes}"
        )


class _LiveAgent:
    """One agent: its commands, the goals that it is given, and the ends of its episode so far."""

    def __init__(
        self,
        group: AgentGroup,
        index: int,
        prefix: str,
        participant: Participant,
        conf: LiveConf,
        report: Report,
    ) -> None:
        self.group, self.index, self.name = group, index, group.names[index]
        self.command_topic, self.command_type = f"/{prefix}cmd_vel", TWIST_STAMPED if conf.stamped else TWIST
        self.commands = VelocityCommands(
            group.body.vehicle(), conf.command_timeout_s, self.command_topic, report
        )
        self._twists = participant.subscribe(self.command_topic, self.command_type)
        self._goal_topic = f"/{prefix}goal_pose"
        self._goals = participant.subscribe(self._goal_topic, _POSE)
        self._report = report
        self.ends: set[str] = set()

    def take(self, time_ns: int) -> None:
        """Take the commands and goals that have arrived."""
        for received in self._twists.take():
            self.commands.take(received.message, time_ns)
        for received in self._goals.take():
            self._set_goal(received.message)

    def _set_goal(self, message: Any) -> None:
        frame, at = message.header.frame_id.lstrip("/"), message.pose.position
        goal = np.array([[at.x, at.y]])
        if frame != MAP:
            self._report(f"{self._goal_topic}: a goal in the frame {frame!r} is left out; send it in {MAP!r}")
        elif not np.isfinite(goal).all():
            self._report(f"{self._goal_topic}: a goal at {at.x}, {at.y} is left out")
        else:
            self.group.starts.set_goals(np.array([self.index]), goal)
            self.ends.clear()
            self._report(f"{self.name}: goal at {at.x:.2f}, {at.y:.2f} m")


class LiveScene:
    """Runs the one scene of `simulation` on the topics of `participant`, as `conf` says.

    Its groups must not end episodes: `tasks` has the tasks whose terminations say when one is over, by group.
    With `on_end=stay` that is reported and the robots stay where they are; with `reset` the next episode
    begins, as it does after a message on `/reset` and after diverged physics. `/clock` goes on.
    `report` is called with a line for each event.
    """

    def __init__(
        self,
        simulation: VectorSimulation,
        tasks: Mapping[str, TaskConf | None],
        participant: Participant,
        conf: LiveConf,
        report: Report,
    ) -> None:
        self._simulation, self._participant, self._conf, self._report = simulation, participant, conf, report
        self._topics = SimulationTopics.of(simulation, 1)
        # First, so that whoever finds another topic knows whose time its stamps have.
        participant.advertise("/clock", full_name("rosgraph_msgs/Clock"))
        for group in simulation.external:
            if not group.has_speed_and_heading:
                raise ConfigError(
                    f"/cmd_vel has a speed and a yaw rate, and an action of {group.name} has "
                    f"{group.action_size} components; leave robot.action out"
                )
        self._agents = [
            _LiveAgent(group, index, self._topics.prefixes[name], participant, conf, report)
            for group in simulation.external
            for index, name in enumerate(group.names)
        ]
        self._tasks = {
            group.name: Task(task, group.num_rows)
            for group in simulation.external
            if (task := tasks.get(group.name)) is not None
        }
        for name, judge in self._tasks.items():
            if judge.needs_scan:
                simulation.group(name).start_scans()
        self._resets: Subscription = participant.subscribe(_RESET, _EMPTY)
        self._wants_reset = False
        self._step_s = simulation.physics.control_step_s
        self._steps = self._episodes = 0
        self._unread: set[tuple[str, str]] = set()

    def run(self, is_stopped: Callable[[], bool] = lambda: False) -> LiveSummary:
        """Run until `duration_s` of the simulation are over, or it `is_stopped`."""
        self._began_s = self._checked_s = time.monotonic()
        self._due_s = self._began_s
        self._begin()
        most = self._conf.duration_s
        while not is_stopped() and (most is None or self._steps * self._step_s < most):
            self._await_turn()
            self._step()
        return LiveSummary(
            self._steps,
            self._steps * self._step_s,
            time.monotonic() - self._began_s,
            sum(agent.commands.count for agent in self._agents),
            self._episodes,
        )

    @property
    def _time_ns(self) -> int:
        return time_ns_of(self._steps, self._step_s)

    def _begin(self) -> None:
        """Begin the next episode, at rest."""
        self._simulation.reset()
        self._episodes += 1
        self._wants_reset = False
        for agent in self._agents:
            agent.commands.stop()
            agent.ends.clear()
        state = self._simulation.state
        for name, task in self._tasks.items():
            task.reset(np.ones(self._simulation.group(name).num_rows, bool), state.groups[name])
        self._recording = SceneRecording(self._participant, self._topics, 0, self._time_ns)
        self._write()
        if self._episodes == 1:
            commands = ", ".join(agent.command_topic for agent in self._agents)
            self._report(f"publishes {', '.join(self._participant.published)}")
            self._report(f"waits for commands on {commands}")
        self._report(f"episode {int(self._simulation.episodes[0])} begins at {self._time_ns / 1e9:.2f} s")

    def _await_turn(self) -> None:
        """Wait until the next step is due, and take what arrives meanwhile."""
        self._take()
        now_s = time.monotonic()
        if now_s - self._checked_s >= _CHECK_S:
            self._checked_s = now_s
            self._check_types()
        if not self._conf.speed:
            return
        self._due_s = max(self._due_s + self._step_s / self._conf.speed, now_s - _MOST_LAG_S)
        while (left_s := self._due_s - time.monotonic()) > 0.0:
            self._participant.wait(left_s)
            self._take()

    def _take(self) -> None:
        for agent in self._agents:
            agent.take(self._time_ns)
        self._wants_reset |= bool(self._resets.take())

    def _check_types(self) -> None:
        """Report commands of a type that is not read, once."""
        offers = self._participant.offers()
        for agent in self._agents:
            for offer in offers.get(agent.command_topic, ()):
                key = agent.command_topic, offer.type
                if offer.type == agent.command_type or key in self._unread:
                    continue
                self._unread.add(key)
                other = {TWIST_STAMPED: "; set stamped=true", TWIST: "; set stamped=false"}
                self._report(
                    f"{agent.command_topic} is published as {offer.type}, and read as {agent.command_type}"
                    f"{other.get(offer.type, '')}"
                )

    def _step(self) -> None:
        if self._wants_reset:
            self._begin()
        simulation = self._simulation
        actions: dict[str, Array] = {
            group.name: np.zeros((1, group.count, group.action_size)) for group in simulation.external
        }
        for agent in self._agents:
            actions[agent.group.name][0, agent.index] = agent.commands.action(self._time_ns)
        self._recording.write_actions(actions, simulation.state, self._time_ns, as_twist=False)
        result = simulation.step(actions)
        self._steps += 1
        self._write()
        self._wants_reset |= self._judge() or bool(result.done.any())

    def _write(self) -> None:
        self._recording.write_state(self._simulation.state, self._time_ns, self._topics.sense())
        # Last, so that who decides when the clock ticks has the readings of that time.
        self._recording.write_clock(self._time_ns)

    def _judge(self) -> bool:
        """Report collisions and ends; returns whether the episode is over and the next one is to begin."""
        state, over = self._simulation.state, []
        for name, task in self._tasks.items():
            own = state.groups[name]
            ends = task.end(state, own)
            for agent in self._agents:
                if agent.group.name != name:
                    continue
                found = {term for term, flags in ends.by_term.items() if flags[agent.index]}
                news = [term.replace("_", " ") for term in sorted(found - agent.ends)]
                if own.contacts.new[agent.index]:
                    news.insert(0, "collision")
                for each in news:
                    self._report(f"{agent.name}: {each} at {self._time_ns / 1e9:.2f} s")
                agent.ends = found
            over.append(ends.terminated | ends.truncated)
            if ends.by_term[DIVERGED].any():
                return True
        return self._conf.on_end == "reset" and bool(over) and bool(np.concatenate(over).all())
