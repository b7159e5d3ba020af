"""A trained policy drives a robot over live topics of ROS 2."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from dune_rl.clients.driven_policy import DrivenPolicy, goal_source
from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array
from dune_rl.ros.dds import Participant
from dune_rl.ros.live_readings import LiveReadings, StoppedWaitingError
from dune_rl.ros.settings import DrivingConf
from dune_rl.ros.times import NS_PER_S
from dune_rl.ros.transforms import BASE
from dune_rl.ros.velocity_commands import TWIST, TWIST_STAMPED, twist_of_action
from dune_rl.sensors.own_motion import GoalConf
from dune_rl.sensors.sensor import Reading

# How long it waits for a message at most, and at the end until its last command has arrived [s].
_POLL_S, _FLUSH_S = 0.05, 0.5

_GOAL = "goal"

Report = Callable[[str], None]


@dataclass
class DriveSummary:
    """Decisions, times at which the robot was stopped for a fault, goals, and the time that all took [s].

    `latencies_s` are from when the newest message was written to when the command was, for each decision; on
    several machines their clocks are compared.
    """

    decisions: int = 0
    stops: int = 0
    goals: int = 0
    took_s: float = 0.0
    latencies_s: list[float] = field(default_factory=list)

    def __str__(self) -> str:
        rate = self.decisions / max(self.took_s, 1e-9)
        text = f"{self.decisions:,} decisions in {self.took_s:.1f} s ({rate:.1f} a second)"
        if self.latencies_s:
            median, late = 1e3 * np.percentile(self.latencies_s, [50, 95])
            text += f", from message to command {median:.1f} ms (median), {late:.1f} ms (95 %)"
        return f"{text}; stopped {self.stops} times, goals reached: {self.goals}"


class SpeedLimits:
    """Limits of commands beside the policy's own: speed, yaw rate, and change of speed. A stop has none."""

    def __init__(self, conf: DrivingConf) -> None:
        self._conf = conf
        self._speed_mps = 0.0

    def limit(self, speed_mps: float, yaw_rate_radps: float, passed_s: float) -> tuple[float, float]:
        """The command `passed_s` after the last one."""
        conf = self._conf
        speed = _within(speed_mps, conf.max_speed_mps)
        if conf.max_acceleration_mps2 is not None:
            change = _within(speed - self._speed_mps, conf.max_acceleration_mps2 * passed_s)
            speed = self._speed_mps + change
        self._speed_mps = speed
        return speed, _within(yaw_rate_radps, conf.max_yaw_rate_radps)

    def stop(self) -> None:
        self._speed_mps = 0.0


def _within(value: float, most: float | None) -> float:
    return value if most is None else min(max(value, -most), most)


class LiveDriver:
    """Lets a policy drive the robot whose topics `participant` has, as `conf` says; `report` gets lines.

    `period_s` is that of its decisions, by default that of its training. While something is missing, too old
    or does not fit, the robot is told to stand still, and why is reported; it goes on when that is over.
    Raises ConfigError for a policy that commands no speed and heading.
    """

    def __init__(
        self,
        policy: DrivenPolicy,
        participant: Participant,
        conf: DrivingConf,
        report: Report,
        *,
        origin: str,
        topics: Mapping[str, str] | None = None,
        robot: str | None = None,
        base: str | None = None,
        period_s: float | None = None,
    ) -> None:
        interface = policy.interface
        if interface.vehicle is None:
            raise ConfigError(
                f"{policy.file}: the policy of {interface.group} commands no robot by a speed and a heading, "
                "as /cmd_vel needs"
            )
        self._policy, self._participant, self._conf, self._report = policy, participant, conf, report
        self._vehicle = interface.vehicle
        self._period_ns = round((period_s or interface.decision_s) * NS_PER_S)
        self._low = np.array([each.low for each in interface.action])
        self._high = np.array([each.high for each in interface.action])
        parts = policy.sources()
        self._goal = next(
            (name for name in parts if isinstance(interface.sensors.get(name), GoalConf)), _GOAL
        )
        if interface.goal_m is not None:
            # A policy that reads other things of its goal does not know when it is there.
            parts.setdefault(self._goal, goal_source(self._goal))
        prefix = "" if robot is None else f"{robot.strip('/')}/"
        self._topic, self._frame = f"/{prefix}cmd_vel", base or f"{prefix}{BASE}"
        self._limits = SpeedLimits(conf)
        self._began_s = time.monotonic()
        self.summary = DriveSummary()
        if not conf.dry_run:
            participant.advertise(self._topic, TWIST_STAMPED if conf.stamped else TWIST)
        self._find_readings = partial(
            LiveReadings,
            participant,
            parts,
            topics or {},
            conf,
            origin=origin,
            robot=robot,
            base=base,
        )
        self._fault, self._is_at_goal, self._begins = "", False, True
        self._decided_ns: int | None = None

    def run(self, is_stopped: Callable[[], bool] = lambda: False) -> DriveSummary:
        """Drive until the goal (with `once`), for `duration_s`, or until it `is_stopped`; it stands then.

        First it waits for the topics; raises ConfigError where one is missing, or never fits.
        """
        try:
            self._readings = self._find_readings(is_stopped=is_stopped)
        except StoppedWaitingError:
            return self.summary
        if not self._conf.dry_run and self._topic in self._participant.offers():
            self._report(
                f"warning: another program publishes {self._topic}, too; end it, or the robot obeys both"
            )
        self._began_s = time.monotonic()
        due_ns: int | None = None
        try:
            while not (is_stopped() or self._is_over()):
                self._readings.poll(_POLL_S)
                now_ns = self._readings.now_ns
                if self._decided_ns is not None and now_ns < self._decided_ns:
                    # The clock has begun anew.
                    due_ns, self._decided_ns, self._begins = None, None, True
                is_early = due_ns is not None and now_ns < due_ns
                if is_early and not self._readings.clock_stands:
                    self._watch()
                    continue
                if not is_early:
                    # A decision that is late by a period begins the count anew.
                    if due_ns is None or due_ns + self._period_ns <= now_ns:
                        due_ns = now_ns
                    due_ns += self._period_ns
                self._decide(now_ns)
        finally:
            self._stand()
            if not self._conf.dry_run:
                self._participant.flush(_FLUSH_S)
            self.summary.took_s = time.monotonic() - self._began_s
        return self.summary

    def _is_over(self) -> bool:
        most_s = self._conf.duration_s
        if most_s is not None and time.monotonic() - self._began_s > most_s:
            return True
        return self._conf.once and self.summary.goals > 0

    def _watch(self) -> None:
        """Stop between two decisions, too, where a topic has stopped."""
        if self.summary.decisions and not self._fault and (fault := self._readings.fault()):
            self._stop_for(fault)

    def _decide(self, now_ns: int) -> None:
        """Act once, or stop and say why."""
        fault, observation = self._readings.fault(), {}
        if not fault:
            try:
                observation = self._readings.observation()
            except ConfigError as error:
                fault = str(error)
        read = {key: value for key, value in observation.items() if key in self._policy.interface.observation}
        action = None if fault else self._policy.act(read, self._begins)
        if action is not None and not np.isfinite(action).all():
            fault = f"the policy's action is {action.tolist()}"
        if fault:
            self._stop_for(fault)
            return
        if self._fault or not self.summary.decisions:
            self._report("driving again" if self.summary.decisions else "driving")
        self._fault = ""
        if not self.summary.decisions:
            for line in self._readings.misplaced():
                self._report(f"warning: {line}")
        self.summary.decisions += 1
        passed_ns = self._period_ns if self._decided_ns is None else now_ns - self._decided_ns
        self._decided_ns = now_ns
        if self._reaches_goal(observation):
            self._stand()
            return
        assert action is not None
        self._begins = False
        self._command(np.clip(action, self._low, self._high), min(passed_ns, 2 * self._period_ns) / NS_PER_S)
        self.summary.latencies_s.append((time.time_ns() - self._readings.newest_sent_ns) / NS_PER_S)

    def _stop_for(self, fault: str) -> None:
        self._stand()
        # A memory would go on from before, or from what was not finite.
        self._begins = True
        has_driven = self.summary.decisions > 0
        # What has never worked will hardly do so later.
        if not has_driven and time.monotonic() - self._began_s > self._conf.wait_s:
            raise ConfigError(fault)
        topic = fault.partition(":")[0]
        if topic != self._fault.partition(":")[0]:
            self.summary.stops += has_driven and not self._fault
            self._report(f"{'stopped' if has_driven else 'waiting'}: {fault}")
        self._fault = fault

    def _reaches_goal(self, observation: Mapping[str, Reading]) -> bool:
        """Whether the goal is near; reports when it has come near."""
        goal_m = self._policy.interface.goal_m
        if goal_m is None:
            return False
        distance_m = float(observation[self._goal][0])
        was_there, self._is_at_goal = self._is_at_goal, distance_m < goal_m
        if self._is_at_goal and not was_there:
            self.summary.goals += 1
            self._begins = True
            self._report(f"goal reached: {distance_m:.2f} m away")
        return self._is_at_goal

    def _command(self, action: Array, passed_s: float) -> None:
        speed, turn = self._limits.limit(*twist_of_action(self._vehicle, action), passed_s)
        if self._conf.dry_run:
            time_s = self._readings.now_ns / NS_PER_S
            self._report(f"{time_s:.2f} s: {speed:.3f} m/s, {turn:.3f} rad/s")
        else:
            self._write(speed, turn)

    def _stand(self) -> None:
        """Tell the robot to stand still."""
        self._limits.stop()
        if not self._conf.dry_run:
            self._write(0.0, 0.0)

    def _write(self, speed_mps: float, yaw_rate_radps: float) -> None:
        types, now_ns = self._participant.types, self._readings.now_ns
        message = types.planar_twist(speed_mps, yaw_rate_radps)
        if self._conf.stamped:
            header = types.header(now_ns, self._frame)
            message = types.make("geometry_msgs/TwistStamped", header=header, twist=message)
        self._participant.write(self._topic, message, now_ns)
