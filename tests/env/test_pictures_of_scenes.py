"""Pictures of a rover in its scene, and environments that render them."""

import gymnasium
import numpy as np
import pytest
from conformance import difference
from plain_worlds import SIZE, box, plain
from scanning import turned
from scenes import about
from scripted_physics import scripted_simulation
from simulations import act, goals_w, motion_of_group, set_goal, started_simulation

import dune_rl
from dune_rl.core.errors import ConfigError
from dune_rl.env.pictures import Pictures
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.renderer import Viewpoint
from dune_rl.worlds.appearance import bake_world
from dune_rl.worlds.world import BETWEEN_OBJECTS, RegionCandidate, World

# Any ground will do for a rover that is put down by hand.
ANYWHERE = {"spawn": {"region": "anywhere", "max_slope_deg": 60.0, "min_goal_distance_m": 0.0}}


class RoverInWorld:
    """A rover alone where a test puts it in `world`, with its goal at (3, 0), and its pictures."""

    def __init__(self, world: World, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> None:
        self.world = world
        self.simulation, (self._robot,) = scripted_simulation(world, sensors=["goal"], task=ANYWHERE)
        self.pictures = Pictures(self.simulation)
        set_goal(self.simulation, 0, (3.0, 0.0))
        self.put(x, y, yaw)

    def put(self, x: float, y: float, yaw: float) -> None:
        z = float(self.world.terrain.height([x, y])) + 0.125
        self._robot.state = np.array([x, y, z, *about([0, 0, 1], yaw), *[0.0] * 6])
        self.simulation.group().body.read_start(np.array([True]))


def eye_behind(pictures: Pictures, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Where the picture from behind is taken from, (3,)."""
    views: list[Viewpoint] = []
    with monkeypatch.context() as patch:
        patch.setattr(pictures, "seen", lambda view, *_: views.append(view))
        pictures.from_behind()
    return np.array(views[0].eye)


def in_sight(world: World, eye: np.ndarray, position: np.ndarray) -> bool:
    """Whether nothing stands between `eye` and what is a little over the rover."""
    rays = bake_world(world, LightConf()).rays
    towards = eye - position
    length = float(np.linalg.norm(towards))
    return bool(rays.first_hit(position[None], (towards / length)[None], length)[0][0] >= length - 1e-4)


def test_the_view_from_behind_shows_the_rover_in_the_middle(monkeypatch):
    pictures = RoverInWorld(plain(), 1.0, -2.0, 0.8).pictures
    picture = pictures.from_behind(0, *SIZE)
    monkeypatch.setattr(pictures, "bodies", lambda scene: [])
    changed = (picture != pictures.from_behind(0, *SIZE)).any(axis=-1)
    rows, columns = np.nonzero(changed)
    assert changed.sum() > 200
    assert abs(np.median(columns) - SIZE[0] / 2) < SIZE[0] / 8
    assert np.median(rows) > SIZE[1] / 2
    # The top plate is orange.
    red, _, blue = picture[changed].astype(int).T
    assert (red - blue > 60).sum() > 30


@pytest.mark.parametrize("yaw", [0.0, 2.0, -1.3])
def test_the_view_is_from_behind_and_above_and_looks_ahead(yaw, monkeypatch):
    eye = eye_behind(RoverInWorld(plain(), 1.0, -2.0, yaw).pictures, monkeypatch)
    back = turned(yaw).T @ (eye - [1.0, -2.0, 0.125])
    assert back[0] < -2.0 and abs(back[1]) < 1e-6 and back[2] > 1.0


@pytest.mark.slow(all_but=["*0*", "*1*"])
@pytest.mark.parametrize(
    "behind_m",
    [
        0.4,
        0.8,
        1.2,
        2.0,
        2.7,
        4.0,
    ],
)
def test_the_view_is_never_from_behind_a_wall(behind_m, monkeypatch):
    world = plain(box(-behind_m - 0.1, 0.0, 0.2, 6.0, 3.0))
    eye = eye_behind(RoverInWorld(world).pictures, monkeypatch)
    assert eye[0] > -behind_m
    assert in_sight(world, eye, np.array([0.0, 0.0, 0.575]))
    if behind_m > 3.0:
        np.testing.assert_allclose(eye, eye_behind(RoverInWorld(plain()).pictures, monkeypatch))


def test_an_eye_behind_a_wall_or_in_the_ground_has_no_sight_of_the_robot():
    pictures = RoverInWorld(plain(box(2.0, 0.0, 0.2, 6.0, 2.0))).pictures
    position = np.array([0.0, 0.0, 0.125])
    seen = [pictures.is_in_sight(0, position, np.array(eye)) for eye in ((4.0, 0.0, 1.0), (-4.0, 0.0, 1.0))]
    assert seen == [False, True]
    assert not pictures.is_in_sight(0, position, np.array([-4.0, 0.0, -1.0]))
    assert pictures.is_in_sight(0, position, np.array([4.0, 0.0, 6.0]))


def test_the_view_is_never_from_inside_the_ground(monkeypatch):
    rng = np.random.default_rng(3)
    world = plain(heights=rng.normal(0.0, 0.8, (11, 11)))
    rover, nearest = RoverInWorld(world), []
    for x, y, yaw in rng.uniform([-8, -8, -3], [8, 8, 3], (200, 3)):
        rover.put(x, y, yaw)
        eye = eye_behind(rover.pictures, monkeypatch)
        nearest.append(eye[2] - float(world.terrain.height(eye[:2])))
    assert min(nearest) > 0.3
    # Some of them had to give way.
    assert min(nearest) < 0.5


def test_the_view_turns_where_a_walker_would_hide_the_robot(monkeypatch):
    walker = {"waypoints": [[-8.0, 8.0], [8.0, 8.0]]}
    simulation = started_simulation("flat", 1, actors=[walker, walker], sensors=["goal"])
    pictures = Pictures(simulation)
    rover, people = motion_of_group(simulation), simulation.group("walker").body
    place, yaw = rover.position_w[0], float(rover.yaw[0])

    def eye(*bearings: float) -> np.ndarray:
        poses = people.poses.copy()
        for row, bearing in enumerate(bearings):
            poses[row, :2] = place[:2] + 1.2 * np.array([np.cos(yaw + bearing), np.sin(yaw + bearing)])
        people.poses = poses
        people.read()
        views: list[Viewpoint] = []
        with monkeypatch.context() as patch:
            patch.setattr(pictures, "seen", lambda view, *_: views.append(view))
            pictures.from_behind(turns_for_agents=True)
            pictures.from_behind()
        # Films do not turn.
        np.testing.assert_allclose(np.array(views[1].eye)[:2], behind[:2])
        return turned(yaw).T @ (np.array(views[0].eye) - place)

    behind = eye_behind(pictures, monkeypatch)
    assert eye(0.0, 0.5)[0] < -2.0 and abs(eye(0.0, 0.5)[1]) < 1e-6
    left = eye(0.0, np.pi)
    assert abs(left[1]) > 1.0
    # And to the other side, if somebody is there.
    right = eye(np.pi, np.arctan2(left[1], left[0]))
    assert right[1] * left[1] < 0.0
    simulation.close()


def test_a_scene_shows_its_robots_its_walkers_and_the_goals():
    walker = {"waypoints": [[-3.0, 3.0], [3.0, 3.0]]}
    simulation = started_simulation(
        "flat", 2, robots=["rover_zero", "rover_zero"], actors=[walker], sensors=["goal"]
    )
    act(simulation)
    pictures = Pictures(simulation)
    robots, people = motion_of_group(simulation), motion_of_group(simulation, "walker")
    for scene in (0, 1):
        *parts, person, flag, other_flag = pictures.bodies(scene)
        # A hull and four wheels of each rover.
        assert len(parts) == 10
        for number, row in enumerate((2 * scene, 2 * scene + 1)):
            hull = parts[5 * number]
            np.testing.assert_allclose(hull.position, robots.position_w[row])
            np.testing.assert_allclose(hull.rotation, robots.rotation[row])
            goal = (flag, other_flag)[number]
            np.testing.assert_allclose(goal.position, [*goals_w(simulation)[row], 0.0])
        x, y, z = people.position_w[scene]
        np.testing.assert_allclose(person.position, [x, y, z])
        np.testing.assert_allclose(person.rotation, turned(people.yaw[scene]), atol=1e-12)
        view = Viewpoint((x - 3.0, y, 1.0), (x, y, 1.0))
        orange = pictures.seen(view, scene, *SIZE)[30:42, 46:50].reshape(-1, 3).astype(int)
        assert ((orange[:, 0] - orange[:, 2]) > 60).any()
        first, second = (pictures.from_behind(scene, *SIZE, agent=f"rover_{number}") for number in (0, 1))
        assert (first != second).any()
        assert (pictures.from_behind(scene, *SIZE) == first).all()
        assert (pictures.from_behind(1 - scene, *SIZE) != first).any()
        assert (pictures.from_behind(scene, *SIZE, agent="walker_0") != first).any()
    simulation.close()


def test_the_place_is_seen_whole_from_above():
    pictures = RoverInWorld(plain(box(4.0, 4.0, 3.0, 3.0, 3.0, colour=(0.9, 0.1, 0.1)))).pictures
    seen = pictures.of_the_place(0, *SIZE, samples=1)
    assert seen.shape == (72, 96, 3) and seen.dtype == np.uint8
    red = seen[..., 0].astype(int) - seen[..., 1] > 40
    assert red.sum() > 20
    # From the other side the box lies on the other hand.
    other = pictures.of_the_place(0, *SIZE, samples=1, bearing_rad=-2.3 + np.pi)
    assert (other != seen).any()
    row = np.nonzero(other[..., 0].astype(int) - other[..., 1] > 40)[0].mean()
    assert np.nonzero(red)[0].mean() < row - 5
    assert seen[0, :, 2].mean() > seen[0, :, 0].mean()
    assert pictures.of_the_place(0, *SIZE).shape == (72, 96, 3)


def test_of_a_wide_imported_world_the_site_is_seen_and_of_a_small_one_the_inside(tmp_path):
    def view_of(world: World) -> Viewpoint:
        pictures = RoverInWorld(world).pictures
        views: list[Viewpoint] = []
        pictures.seen = lambda view, *_: views.append(view)  # type: ignore[method-assign]
        pictures.of_the_place()
        return views[0]

    def elevation(view: Viewpoint) -> float:
        way = np.array(view.eye) - view.target
        return float(np.arctan2(way[2], np.hypot(way[0], way[1])))

    wide, small = plain(box(4.0, 4.0, 3.0, 3.0, 1.0)), plain(box(4.0, 4.0, 3.0, 3.0, 1.0))
    small.region = (3.0, 6.0, 1.0, 4.0)
    small.region_candidates = (RegionCandidate(small.region, BETWEEN_OBJECTS, 5.0),)
    first, second = view_of(wide), view_of(small)
    away = np.linalg.norm(np.subtract(second.target[:2], (4.5, 3.5)))
    assert away < 1.0 < np.linalg.norm(first.target[:2])
    assert elevation(second) > elevation(first) > np.deg2rad(20.0)


@pytest.mark.slow
@pytest.mark.parametrize("make", [dune_rl.parallel_env, dune_rl.gym_env])
def test_render_gives_a_picture_where_it_was_asked_for(make):
    env, blind = (make("flat", sensors=["goal"], render_mode=mode) for mode in ("rgb_array", None))
    for each in (env, blind):
        each.reset(seed=1)
    first = env.render()
    assert first.shape == (480, 640, 3) and first.dtype == np.uint8
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 1000
    assert blind.render() is None
    assert (env.render_mode, blind.render_mode) == ("rgb_array", None)
    env.reset(seed=2)
    assert (env.render() != first).any()
    # Looking changes nothing.
    env.reset(seed=1)
    np.testing.assert_array_equal(env.render(), first)
    action = np.array([1.0, 0.3], np.float32)
    given = action if make is dune_rl.gym_env else {"rover_0": action}
    for _ in range(3):
        assert difference(list(env.step(given)), list(blind.step(given))) is None
        env.render()
    env.close()
    blind.close()


@pytest.mark.parametrize("make", [dune_rl.parallel_env, dune_rl.gym_env])
def test_an_unknown_way_to_render_is_refused_in_words(make):
    with pytest.raises(ConfigError) as refused:
        make("flat", render_mode="ansi")
    assert str(refused.value) == "render_mode must be 'human', 'rgb_array' or None (got 'ansi')"


def test_gymnasium_s_own_wrappers_can_render():
    env = gymnasium.make("dune_rl/Flat-v0", render_mode="rgb_array", physics={"control_hz": 10})
    env.reset(seed=0)
    assert env.render().shape == (480, 640, 3)
    assert env.unwrapped.metadata["render_fps"] == 10
    env.close()
