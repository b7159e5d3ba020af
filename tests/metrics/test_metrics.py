"""Metrics on sequences small enough to work out by hand, and what an encounter is."""

import numpy as np
import pytest
from scenes import HULL_HALF_LENGTH_M, WHEEL_RADIUS_M, Backend, every_backend

from dune_rl.actors.actor import ActorConf
from dune_rl.env.batch import Batch
from dune_rl.geometry.heightfield import HeightField
from dune_rl.metrics.episode import METRICS, EpisodeMetrics, MetricsConf
from dune_rl.physics.interface import PhysicsConf, PhysicsScene, SceneSpec
from dune_rl.robots.rover_zero.robot import RoverZero, RoverZeroConf
from dune_rl.sensors.conf import SensorsConf
from dune_rl.tasks.point_goal import PointGoalConf
from dune_rl.tasks.spawn import SpawnConf
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

FLAGS = ("diverged", "stuck", "flipped", "out_of_world", "timeout")
ALL = np.array([True])


class Episode:
    """One scene's metrics, fed one step at a time."""

    def __init__(self, conf: MetricsConf | None = None) -> None:
        self._metrics = EpisodeMetrics(conf or MetricsConf(), 1)
        self.begin(7)

    def begin(self, number: int) -> None:
        self._metrics.reset(ALL, np.array([number]))
        self._steps = 0

    def step(
        self,
        reward: float = 0.0,
        clearance: float = np.inf,
        acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0),
        turning: tuple[float, float, float] = (0.0, 0.0, 0.0),
        speed: float = 0.0,
        tilt: float = 0.0,
        collisions: int = 0,
        reached: bool = False,
        **flags: bool,
    ) -> None:
        self._steps += 1
        self._metrics.update(
            steps=np.array([self._steps]),
            step_s=0.05,
            reward=np.array([reward]),
            clearance=np.array([clearance]),
            acceleration_b=np.array([acceleration]),
            angular_b=np.array([turning]),
            ground_speed=np.array([speed]),
            tilt=np.array([tilt]),
            new_collisions=np.array([collisions]),
            reached=np.array([reached]),
            flags={name: np.array([flags.get(name, False)]) for name in FLAGS},
        )

    def __getitem__(self, name: str) -> float:
        return float(self._metrics.values[0, METRICS.index(name)])


def test_a_fresh_episode_has_no_figures_yet():
    episode = Episode()
    values = {name: episode[name] for name in METRICS}
    assert values.pop("episode") == 7
    assert np.isnan([values.pop("time_to_goal"), values.pop("vort")]).all()
    assert (values.pop("clearance"), values.pop("min_clearance")) == (12.0, 12.0)
    assert set(values.values()) == {0.0}


def test_return_and_steps_add_up():
    episode = Episode()
    for reward in (1.0, -0.5, 0.25):
        episode.step(reward)
    assert (episode["return"], episode["steps"]) == (0.75, 3)


def test_clearance_is_the_mean_of_what_lies_within_twelve_metres():
    episode = Episode()
    for clearance in (np.inf, 2.0, 30.0, 0.0):
        episode.step(clearance=clearance)
    assert episode["clearance"] == pytest.approx((12 + 2 + 12 + 0) / 4)
    assert episode["min_clearance"] == 0.0


def test_vertical_roughness_is_the_mean_size_of_vertical_acceleration():
    episode = Episode()
    for z in (1.0, -3.0, 0.5):
        episode.step(acceleration=(9.0, -9.0, z))
    assert episode["vertical_roughness"] == pytest.approx(1.5)


def test_smoothness_is_the_mean_of_acceleration_and_turning():
    episode = Episode()
    episode.step(acceleration=(3.0, 0.0, 4.0), turning=(0.0, 0.6, 0.8))
    episode.step(acceleration=(0.0, -2.0, 0.0), turning=(0.0, 0.0, -0.5))
    assert episode["smoothness"] == pytest.approx((5 + 1 + 2 + 0.5) / 2)


def test_vort_is_the_speed_on_uneven_ground_alone():
    episode = Episode()
    episode.step(speed=1.0, tilt=np.deg2rad(4.9))
    assert np.isnan(episode["vort"])
    episode.step(speed=0.6, tilt=np.deg2rad(5.1))
    episode.step(speed=0.2, tilt=np.deg2rad(30.0))
    episode.step(speed=1.0, tilt=0.0)
    assert episode["vort"] == pytest.approx(0.4)


def test_the_battery_s_share_and_range_follow_from_energy_and_way():
    metrics = EpisodeMetrics(MetricsConf(energy=True), 2, capacity_wh=50.0)
    columns = [metrics.names.index(name) for name in ("energy_wh", "battery_share", "range_km")]
    for _ in range(2):
        metrics.reset(np.array([True, True]), np.array([0, 1]))
        np.testing.assert_array_equal(metrics.values[:, columns], [[0.0, 0.0, np.nan]] * 2)
        # Two steps of 0.5 s: 3 m for 0.01 W h, of which 50 last for 15 km; the other does nothing.
        for speed, drawn in ((2.0, 0.004), (4.0, 0.006)):
            still = np.zeros(2)
            metrics.update(
                steps=np.array([1, 1]),
                step_s=0.5,
                reward=still,
                clearance=still,
                acceleration_b=np.zeros((2, 3)),
                angular_b=np.zeros((2, 3)),
                ground_speed=np.array([speed, 0.0]),
                tilt=still,
                new_collisions=np.zeros(2, int),
                reached=np.zeros(2, bool),
                flags={},
                energy_wh=np.array([drawn, 0.0]),
            )
        np.testing.assert_allclose(metrics.values[:, columns], [[0.01, 0.0002, 15.0], [0.0, 0.0, np.nan]])


def test_thresholds_are_settings():
    episode = Episode(MetricsConf(max_clearance_m=3.0, uneven_tilt_rad=0.0))
    episode.step(clearance=5.0, speed=0.7, tilt=0.01)
    assert (episode["clearance"], episode["vort"]) == (3.0, pytest.approx(0.7))


def test_a_goal_without_collision_is_a_success():
    episode = Episode()
    episode.step()
    episode.step()
    assert (episode["reached"], episode["success"]) == (0.0, 0.0)
    episode.step(reached=True)
    assert (episode["reached"], episode["success"], episode["goals"]) == (1.0, 1.0, 1.0)
    assert episode["time_to_goal"] == pytest.approx(0.15)


@pytest.mark.parametrize("before", [True, False], ids=["before", "on arrival"])
def test_a_goal_with_a_collision_is_none(before):
    episode = Episode()
    episode.step(collisions=int(before))
    episode.step(reached=True, collisions=int(not before))
    assert (episode["reached"], episode["success"], episode["collisions"]) == (1.0, 0.0, 1.0)


def test_collisions_add_up_and_spoil_an_earlier_success():
    episode = Episode()
    episode.step(reached=True)
    assert episode["success"] == 1.0
    episode.step(collisions=2)
    episode.step(collisions=1)
    assert (episode["success"], episode["collisions"]) == (0.0, 3.0)


def test_the_time_is_that_of_the_first_goal():
    episode = Episode()
    episode.step()
    episode.step(reached=True)
    episode.step()
    episode.step(reached=True)
    assert (episode["goals"], episode["time_to_goal"]) == (2.0, pytest.approx(0.1))


@pytest.mark.parametrize("flag", FLAGS)
def test_why_an_episode_ended_is_told(flag):
    episode = Episode()
    episode.step()
    episode.step(**{flag: True})
    assert {name for name in FLAGS if episode[name]} == {flag}


def test_a_new_episode_forgets_the_last():
    episode, fresh = Episode(), Episode()
    for _ in range(3):
        episode.step(1.0, 0.0, (1, 1, 1), (1, 1, 1), 1.0, 1.0, 1, True, stuck=True)
    episode.begin(7)
    for one in (episode, fresh):
        one.step(0.5, 2.0, (0, 0, 1), (0, 0, 1), 0.3, 0.2)
    for name in METRICS:
        np.testing.assert_equal(episode[name], fresh[name], err_msg=name)


def test_a_reset_leaves_other_scenes_alone():
    metrics = EpisodeMetrics(MetricsConf(), 2)
    metrics.reset(np.array([True, True]), np.array([0, 1]))
    metrics.values[:, METRICS.index("return")] = 5.0
    metrics.reset(np.array([False, True]), np.array([2, 3]))
    np.testing.assert_array_equal(metrics.values[:, :3:2], [[0.0, 5.0], [3.0, 0.0]])


# -- encounters ------------------------------------------------------------------------------------

WALKER = ActorConf(controller="external", waypoints=((-3.0, 8.0), (3.0, 8.0)))


class Meeting:
    """A rover put down beside a wall whose face is at x = 1, and a walker at one's command."""

    def __init__(self, backend: Backend, x: float) -> None:
        wall = Prop("wall", "wall", *upright_box((1.1, 0.0), 0.0, -0.1, 1.0, 0.2, 4.0))
        terrain = HeightField(np.zeros((21, 21)), 1.0, (-10.0, -10.0))
        scenes: list[PhysicsScene] = []

        def make_scene(spec: SceneSpec) -> PhysicsScene:
            scenes.append(backend(spec))
            return scenes[-1]

        self.batch = Batch(
            world=World("yard", terrain, [wall], region=(-8.0, -4.0, -8.0, -4.0)),
            make_robot=lambda count: RoverZero(RoverZeroConf(), count),
            make_scene=make_scene,
            actors=(WALKER,),
            sensors=SensorsConf(),
            physics=PhysicsConf(),
            task=PointGoalConf(spawn=SpawnConf()),
            metrics=MetricsConf(),
            num_scenes=1,
        )
        self.batch.reset()
        scenes[0].robots[0].set_start_pose([x, 0.0, WHEEL_RADIUS_M], [0.0, 0.0, 0.0, 1.0])
        scenes[0].reset(self.batch.actors.poses[0])

    def drive(self, speed: float, seconds: float, walker_speed: float = 0.0) -> None:
        for _ in range(round(seconds / 0.05)):
            self.batch.step(
                np.array([[speed, 0.0]], np.float32), np.array([[[walker_speed, 0.0]]], np.float32)
            )

    def put_walker(self, x: float, y: float, yaw: float) -> None:
        self.batch.actors.poses[0, 0] = x, y, 0.0, yaw

    def __getitem__(self, name: str) -> float:
        return float(self.batch.metrics()[0, self.batch.metric_names.index(name)])


@every_backend
def test_a_long_push_is_one_collision_and_a_later_touch_another(backend):
    meeting = Meeting(backend, 0.5)
    meeting.drive(0.0, 0.5)
    assert meeting["collisions"] == 0
    meeting.drive(0.5, 4.0)
    assert meeting["collisions"] == 1
    assert meeting["min_clearance"] == 0.0
    # Off the wall for less than a second is the same encounter still.
    meeting.drive(-0.5, 0.3)
    meeting.drive(0.5, 1.0)
    assert meeting["collisions"] == 1
    meeting.drive(-0.5, 1.0)
    meeting.drive(0.0, 0.5)
    meeting.drive(0.5, 2.0)
    assert meeting["collisions"] == 2


@every_backend
@pytest.mark.parametrize("x", [-2.0, 0.0, 0.3])
def test_clearance_is_never_more_than_there_is(backend, x):
    # And at most 0.2 m less: a cell of the world's grid, and the circles that stand for the hull.
    meeting = Meeting(backend, x)
    meeting.drive(0.0, 0.1)
    truly = 1.0 - (x + HULL_HALF_LENGTH_M)
    assert truly - 0.2 < meeting["min_clearance"] < truly + 0.01


@every_backend
def test_a_walker_counts_beside_the_wall(backend):
    meeting = Meeting(backend, 0.0)
    meeting.put_walker(-2.0, 0.0, 0.0)
    meeting.drive(0.0, 3.0, walker_speed=1.0)
    # It pushed the rover to the wall: one encounter with each.
    assert meeting["collisions"] == 2
    meeting.drive(0.0, 1.0)
    assert meeting["collisions"] == 2


@every_backend
def test_an_encounter_costs_success_and_tells_the_reward(backend):
    meeting = Meeting(backend, 0.5)
    meeting.drive(0.5, 3.0)
    assert meeting["reward/collision"] == pytest.approx(-0.5 * meeting["steps"], abs=1e-3)
    meeting.batch.goals_w[0] = meeting.batch.motion.position_w[0, :2]
    meeting.drive(0.0, 0.05)
    assert (meeting["reached"], meeting["success"]) == (1.0, 0.0)


@every_backend
def test_driving_on_the_ground_is_no_collision(backend):
    meeting = Meeting(backend, -6.0)
    meeting.drive(1.0, 4.0)
    assert meeting["collisions"] == 0
