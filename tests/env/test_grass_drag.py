"""Tall grass holds back what drives through it."""

import numpy as np
from grass_samples import SMALL
from scenes import Stage, every_backend
from scripted_physics import scripted_simulation
from sensors_of_rover_zero import lidar_conf
from simulations import act, every_engine, motion_of_group, observation, started_simulation


@every_backend
def test_a_push_accelerates_for_one_step(backend):
    stage = Stage(backend)
    stage.place([0.0, 0.0, 5.0])
    stage.engine.apply_force([22.0, -11.0, 0.0])
    stage.step(10)
    # Its wheels hang below the chassis' centre by nothing, so that 11 kg move as one.
    np.testing.assert_allclose(stage.velocity[:2], [22 / 11 * 0.05, -0.05], rtol=0.02)
    before = stage.velocity[:2].copy()
    stage.step(10)
    np.testing.assert_allclose(stage.velocity[:2], before, atol=1e-3)
    stage.engine.apply_force([22.0, 0.0, 0.0])
    stage.place([0.0, 0.0, 5.0])
    stage.step(10)
    np.testing.assert_allclose(stage.velocity[:2], 0.0, atol=1e-9)


@every_backend
def test_a_push_of_nothing_keeps_the_bytes(backend):
    states = []
    for push in (False, True):
        stage = Stage(backend)
        stage.place()
        for _ in range(5):
            if push:
                stage.engine.apply_force([0.0, 0.0, 0.0])
            stage.step(10, 4.0)
        states.append(stage.state.tobytes())
    assert states[0] == states[1]


def test_the_force_is_against_the_motion_and_by_what_stands_in_grass():
    cover = {"name": "flat", "grass_cover": 1.0, "grass_height_m": 2.0}
    simulation, (robot,) = scripted_simulation(cover)
    world = simulation.worlds.worlds[0]
    grass = world.grass
    dense = np.unravel_index(grass.density.argmax(), grass.density.shape)
    xmin, _, ymin, _ = world.extent
    x, y = (-xmin) * (2 * dense[1] + 1) / grass.density.shape[1], (-ymin) * (2 * dense[0] + 1) / 400
    robot.put(xmin + x, ymin + y)
    robot.state[7:10] = 0.5, -0.3, 0.1
    act(simulation)
    act(simulation)
    # The first push comes from where the rover had been put at the start, at rest.
    np.testing.assert_allclose(robot.pushes[-1], -20.0 * np.array([0.5, -0.3, 0.1]), rtol=1e-4)
    robot.state[2] = 0.125 + 2.0 - 0.127
    act(simulation)
    act(simulation)
    np.testing.assert_allclose(robot.pushes[-1], -10.0 * np.array([0.5, -0.3, 0.1]), rtol=1e-3)
    bare, (other,) = scripted_simulation()
    act(bare)
    assert other.pushes == []


def test_grass_holds_each_robot_of_a_scene_back_by_itself():
    cover = {"name": "flat", "grass_cover": 1.0, "grass_height_m": 2.0}
    simulation, robots = scripted_simulation(cover, num_scenes=2, robots=["rover_zero", "rover_zero"])
    grass = simulation.worlds.worlds[0].grass
    speeds = (0.5, 0.0, 0.2, -0.4)
    for place, (robot, speed) in enumerate(zip(robots, speeds, strict=True)):
        robot.put(1.5 * place, 2.0)
        robot.state[7] = speed
    act(simulation)
    act(simulation)
    bottoms = np.array([[1.5 * place, 2.0, 0.0] for place in range(4)])
    held = -grass.drag(bottoms, simulation.group().body.robot.description.height_m) * speeds
    np.testing.assert_allclose([robot.pushes[-1][0] for robot in robots], held, rtol=1e-6, atol=1e-9)
    assert np.abs(held).max() > 1.0


@every_engine
def test_driving_through_it_takes_torque_and_costs_speed(engine):
    drive = {"drive": {"max_torque_nm": 0.25}}
    speeds, torques = {}, {}
    for strong in (True, False):
        for cover in (0.0, 1.0):
            world = {**SMALL, "grass_cover": cover}
            settings = {} if strong else {"robot": drive}
            simulation = started_simulation(world, 1, sensors=["imu", "goal"], physics=engine, **settings)
            for _ in range(40):
                act(simulation, [0.8, 0.0])
            speeds[strong, cover] = np.hypot(*motion_of_group(simulation).velocity_w[0, :2])
            torques[strong, cover] = np.sum(simulation.scenes.robots(0)[0].drive_state()[8:])
            simulation.close()
    # Strong drives hold their speed, at the cost of what the grass takes; weak ones do not.
    assert speeds[True, 1.0] > 0.7
    assert torques[True, 1.0] > torques[True, 0.0] + 0.3
    assert 0.2 < speeds[False, 1.0] < speeds[False, 0.0] - 0.05


def test_scenes_in_grass_are_independent_and_repeat():
    settings = {"sensors": ["lidar", "camera", "imu", "goal"]}
    world = {**SMALL, "grass_cover": 0.5}
    seen = []
    for scenes in (1, 2):
        simulation = started_simulation(world, scenes, seed=3, **settings)
        for _ in range(3):
            act(simulation, [0.5, 0.2])
        seen.append({name: value[0].tobytes() for name, value in observation(simulation).items()})
        simulation.close()
    assert seen[0] == seen[1]
    assert lidar_conf().n_segments * 4 == len(seen[0]["lidar"])
