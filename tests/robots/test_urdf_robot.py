"""Robots from URDFs: what is derived, that they drive, and words for what is wrong."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from defusedxml.ElementTree import parse
from scenes import STEP_S, Drive, every_backend
from simulations import act, motion_of_group, state_of_group
from urdf_files import CART, write_cart

from dune_rl.commands.robots import run
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError, RobotError
from dune_rl.core.paths import assets_folder
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.robot import UrdfRobot
from dune_rl.robots.visual import RobotVisual

MASS_KG = 8.0 + 0.5 + 2 * 0.5 + 0.1


def cart(folder: Path, text: str = CART, **settings: object) -> UrdfRobot:
    return UrdfRobot(UrdfConf(path=str(write_cart(folder, text)), **settings), 1)


def test_all_that_can_be_is_derived(tmp_path):
    robot = cart(tmp_path)
    # From the root link, which lies on the ground's level but for a millimetre or so.
    assert robot.description.standing_height_m == pytest.approx(0.0, abs=1e-3)
    assert (robot.description.length_m, robot.description.width_m) == pytest.approx((0.4, 0.44), abs=1e-3)
    assert robot.description.height_m == pytest.approx(0.16, abs=1e-3)
    np.testing.assert_allclose(
        robot.description.contact_centres_b, [[0.05, 0.2, 0.08], [0.05, -0.2, 0.08]], atol=1e-6
    )
    assert robot.drive.wheel_radius_m == pytest.approx(0.08, abs=1e-3)
    # Two wheels do not scrub; joints' limits are the motors'.
    assert robot.drive.effective_track_m == pytest.approx(0.4, abs=1e-3)
    assert robot.drive.max_speed_mps == pytest.approx(0.8, abs=0.01)
    assert robot.drive.max_torque_nm == 3.0
    assert robot.description.mounts.scanner_b == pytest.approx((0.0, 0.0, 0.21), abs=1e-3)
    assert robot.description.wheels.left == (0,) and robot.description.wheels.right == (1,)
    assert f"{MASS_KG:.2f} kg in 3 moving parts" in robot.summary()


def test_fixed_links_are_weighed_together(tmp_path):
    robot = cart(tmp_path)
    root = parse(robot.body.urdf).getroot()
    base = root.find("link").find("inertial")
    assert float(base.find("mass").get("value")) == pytest.approx(8.6)
    centre = [float(word) for word in base.find("origin").get("xyz").split()]
    # Over the ground: body, arm and caster.
    parts = [(8.0, (0.01, 0.0, 0.12)), (0.5, (-0.1, 0.0, 0.28)), (0.1, (-0.15, 0.0, 0.04))]
    expected = sum(mass * np.array(where) for mass, where in parts) / 8.6
    np.testing.assert_allclose(centre, expected, atol=1e-9)
    moments = [float(base.find("inertia").get(name)) for name in ("ixx", "iyy", "izz")]
    inertia = np.diag([0.08, 0.12, 0.15]) + np.diag([0.0021, 0.0021, 0.0011])
    for mass, where in parts:
        away = np.array(where) - expected
        inertia += mass * (away @ away * np.eye(3) - np.outer(away, away))
    np.testing.assert_allclose(moments, np.diag(inertia), atol=1e-9)


@every_backend
def test_it_drives_straight_and_turns_as_told(backend, tmp_path):
    robot = cart(tmp_path, hull_friction=0.05)
    drive = Drive(backend, rover=robot, position_w=(0.0, 0.0, robot.description.standing_height_m + 0.003))
    for _ in range(40):
        drive.step(0.5, 0.0)
    assert drive.stage.velocity[0] == pytest.approx(0.5, rel=0.05)
    assert abs(drive.stage.position[1]) < 0.03
    # The right wheel's axis points the other way; both roll forward at a positive speed.
    np.testing.assert_allclose(drive.stage.wheel_speeds, 0.5 / robot.drive.wheel_radius_m, rtol=0.05)
    yaws = []
    for _ in range(40):
        drive.step(0.0, 0.4)
        yaws.append(drive.stage.yaw)
    yaws = np.unwrap(yaws)
    assert (yaws[-1] - yaws[19]) / (20 * STEP_S) == pytest.approx(0.8, rel=0.1)


@every_backend
def test_rover_zero_from_its_urdf_drives_as_the_built_in(backend):
    own = RoverZero(RoverZeroConf(), 1)
    read = UrdfRobot(
        UrdfConf(
            path=str(assets_folder() / "robots" / "rover_zero" / "rover_zero.urdf"),
            drive=RoverZeroConf().drive.model_dump(),
        ),
        1,
    )
    states = []
    for robot in (own, read):
        drive = Drive(backend, rover=robot)
        for _ in range(40):
            drive.step(0.7, 0.2)
        states.append(drive.stage.state)
    np.testing.assert_allclose(*states, atol=2e-3)


@pytest.mark.parametrize(("material", "redder"), [(True, True), (False, False)])
def test_its_looks_come_from_its_package(tmp_path, material, redder):
    path = write_cart(tmp_path, CART if material else CART.replace('<material name="red"/>', ""))
    # Its own colour, where the URDF gives none, is blue.
    shell = trimesh.creation.box((400.0, 300.0, 120.0))
    shell.visual.face_colors = [0, 0, 255, 255]
    shell.export(path.parent.parent / "meshes" / "shell.glb")
    path.write_text(path.read_text().replace('shell.obj" scale', 'shell.glb" scale'))
    robot = UrdfRobot(UrdfConf(path=str(path)), 1)
    (body,) = RobotVisual(robot.body.look).posed_meshes(np.zeros(3), np.eye(3))
    shape = body.solid.shape
    np.testing.assert_allclose(np.ptp(shape.vertices, axis=0), [0.4, 0.3, 0.12], atol=1e-6)
    assert (shape.albedo[:, 0] > 5 * shape.albedo[:, 2]).all() == redder
    assert (shape.albedo[:, 2] > 5 * shape.albedo[:, 0]).all() != redder


def test_packages_are_looked_for_in_the_variable_too(tmp_path, monkeypatch):
    path = write_cart(tmp_path / "here")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (path.parent.parent).rename(elsewhere / "cart_description")
    lonely = tmp_path / "lonely.urdf"
    lonely.write_text(CART)
    with pytest.raises(RobotError, match=r"no package 'cart_description'.*set ROS_PACKAGE_PATH"):
        UrdfRobot(UrdfConf(path=str(lonely)), 1)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere{os.pathsep}{elsewhere}")
    assert UrdfRobot(UrdfConf(path=str(lonely)), 1).drive.max_torque_nm == 3.0


def test_nothing_outside_the_package_is_read(tmp_path):
    (tmp_path / "secret.obj").write_text("v 0 0 0\n")
    for name in (
        "package://cart_description/../secret.obj",
        "../../secret.obj",
        str(tmp_path / "secret.obj"),
    ):
        text = CART.replace("package://cart_description/meshes/shell.obj", name)
        with pytest.raises(RobotError, match=r"leads out of the folder|is not in"):
            cart(tmp_path, text)
    link = tmp_path / "cart_description" / "meshes" / "link.obj"
    link.symlink_to(tmp_path / "secret.obj")
    text = CART.replace("shell.obj", "link.obj")
    with pytest.raises(RobotError, match="leads out of the folder"):
        cart(tmp_path, text)


@pytest.mark.parametrize(
    "mesh",
    [
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n",
    ],
)
def test_a_flat_mesh_collides_with_nothing(mesh, tmp_path):
    cart(tmp_path)
    (tmp_path / "cart_description" / "meshes" / "flat.obj").write_text(mesh)
    with pytest.raises(RobotError, match=r"the mesh .*flat\.obj' is flat or empty, so that nothing can"):
        cart(tmp_path, CART.replace("shell.obj", "flat.obj"))


MASS, WHEEL = '<mass value="8"/>', '<mass value="0.5"/>'
ARM = CART[CART.index('<joint name="arm_joint"') : CART.index("</joint>", CART.index("arm_joint")) + 8]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (MASS, '<mass value="-8"/>', r"cart\.urdf: link 'base_link': its <mass> is -8 kg; a mass is above 0"),
        (MASS, '<mass value="nan"/>', r"link 'base_link': <mass> value='nan' must be 1 finite numbers"),
        (MASS, '<mass value="heavy"/>', r"link 'base_link': <mass> value='heavy' must be 1 finite numbers"),
        ('ixx="0.08"', 'ixx="-1"', r"link 'base_link': its <inertia> is that of no body"),
        ('ixx="0.08"', 'ixx="0.8"', r"link 'base_link': its <inertia> is that of no body.*the other two"),
        ('ixx="0.08"', 'ixx="inf"', r"link 'base_link': <inertia> ixx='inf' must be"),
        (WHEEL, '<mass value="0"/>',
         r"link 'wheel_l' has no mass, nor has what is fixed to it, and joint 'wheel_l_joint' moves it"),
        ("meshes/shell.obj", "meshes/none.obj",
         r"link 'base_link': the mesh .*none\.obj is not in .*copy it there"),
        ("meshes/shell.obj", "package.xml", r"the mesh .*package\.xml has the ending \.xml; meshes are read"),
        ('<parent link="base_link"/><child link="arm"/>', '<parent link="arm"/><child link="base_link"/>',
         r"link 'base_link' is the child of two joints"),
        (ARM, "", r"2 links have no parent \(base_footprint, arm\); join all but the base"),
        ('<child link="arm"/>', '<child link="leg"/>', r"joint 'arm_joint': its child is 'leg', and no link"),
        ('type="revolute"', 'type="floating"', r"joint 'arm_joint' has the type 'floating'; types are fixed"),
        ('<link name="laser"/>', f'<link name="{"x" * 5000}"/>',
         r"a <link> has a name of 5,000 letters, more than 255; shorten it"),
        ('<robot name="cart"', f'<robot name="{"x" * 5000}"', r"a <robot> has a name of 5,000 letters, more"),
        ('<link name="laser"/>', '<link name="arm"/>', r"there are two links 'arm'; rename one"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', r"joint 'wheel_l_joint': its <axis> has no length"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="1 0 0"/>',
         r"no wheels are found on both sides; name them in robot\.left"),
        ('lower="-1"', 'lower="2"', r"joint 'arm_joint': its <limit> has lower 2 above upper 1"),
        ('<child link="arm"/>', '<child link="arm"/><mimic joint="wheel_l_joint" multiplier="0"/>',
         r"joint 'arm_joint': its <mimic> has the multiplier 0"),
        ('radius="0.08"', 'radius="0"', r"link 'wheel_l': a <cylinder> has a size of 0 m"),
        ('<sphere radius="0.04"/>', "<cone/>", r"link 'caster': a <cone> is no shape of a URDF"),
        ('<origin xyz="-0.15 0 -0.06"/>', '<origin xyz="-0.15 0 -0.2"/>',
         r"its hull reaches 0\.\d+ m below its wheels"),
        ("<robot name=", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name=', ""),
        ('<link name="laser"/>', '<xacro:macro xmlns:xacro="http://www.ros.org/wiki/xacro" name="m"/>',
         r"cart\.urdf is a xacro file; expand it first: xacro cart\.urdf > cart_expanded\.urdf"),
        ("</robot>", "", r"cart\.urdf is no valid XML"),
        ("<robot name=", '<!DOCTYPE r [<!ENTITY a "a"><!ENTITY b "&a;&a;">]><robot name=',
         r"declares XML entities"),
        ("<robot", "<sdf", r"no valid XML|begins with <sdf>"),
    ],
)  # fmt: skip
def test_faults_are_told_with_their_remedy(tmp_path, old, new, message):
    assert old in CART
    text = (
        CART.replace(old, new)
        if old != "<robot"
        else CART.replace("<robot", "<sdf").replace("</robot", "</sdf")
    )
    if not message:
        # A namespace that nothing uses does no harm.
        cart(tmp_path, text)
        return
    with pytest.raises(RobotError, match=message):
        cart(tmp_path, text)


def test_a_loop_is_told(tmp_path):
    text = CART.replace('<link name="base_footprint"/>', "").replace(
        '<parent link="base_footprint"/><child link="base_link"/>',
        '<parent link="laser"/><child link="base_link"/>',
    )
    with pytest.raises(RobotError, match="its joints run in a loop"):
        cart(tmp_path, text)


def test_files_that_are_none_are_told(tmp_path):
    with pytest.raises(RobotError, match=r"there is no file .*absent\.urdf: robot\.path must name a URDF"):
        UrdfRobot(UrdfConf(path=str(tmp_path / "absent.urdf")), 1)
    with pytest.raises(RobotError, match="no plain file"):
        UrdfRobot(UrdfConf(path=str(tmp_path)), 1)
    path = tmp_path / "cart.urdf.xacro"
    path.write_text(CART)
    with pytest.raises(RobotError, match=r"expand it first: xacro cart\.urdf\.xacro > cart\.urdf"):
        UrdfRobot(UrdfConf(path=str(path)), 1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"left_wheels": ("wheel_l_joint",)},
         r"must both name joints, or both be null; cart\.urdf has arm_joint"),
        ({"left_wheels": ("wheel_l_joint",), "right_wheels": ("wheel_x",)},
         r"robot\.right_wheels: cart\.urdf has no joint wheel_x; it has arm_joint \(revolute\), wheel_l_"),
        ({"left_wheels": ("wheel_r_joint",), "right_wheels": ("wheel_l_joint",)},
         r"robot\.left_wheels: joint wheel_r_joint of cart\.urdf is at y = -0\.200 m.*change sides"),
        ({"left_wheels": ("arm_joint",), "right_wheels": ("wheel_r_joint",)},
         r"arm_joint of cart\.urdf is revolute"),
        ({"left_wheels": ("wheel_l_joint",), "right_wheels": ("wheel_l_joint",)}, r"both name wheel_l_joint"),
        ({"free_joints": ("base_joint",)}, r"robot\.free_joints: joint base_joint of cart\.urdf is fixed"),
        ({"free_joints": ("knee",)}, r"robot\.free_joints: cart\.urdf has no joint knee"),
    ],
)  # fmt: skip
def test_settings_that_do_not_fit_the_file_are_told(tmp_path, settings, message):
    with pytest.raises(RobotError, match=message):
        cart(tmp_path, **settings)


@pytest.mark.parametrize("words", [["robot=urdf"], ["+robot=urdf"]])
def test_the_command_line_chooses_it(tmp_path, words):
    path = write_cart(tmp_path)
    conf = compose_environment("flat", ["actors=none", *words, f"robot.path={path}"])
    simulation = make_simulation(conf, 2, 0)
    simulation.reset()
    for _ in range(20):
        act(simulation, [[0.5, 0.0], [0.0, 0.5]])
    assert not state_of_group(simulation).motion.diverged.any()
    assert motion_of_group(simulation).velocity_b[0, 0] == pytest.approx(0.5, rel=0.1)
    # Over the body, whose top is 0.16 m high.
    assert simulation.group().suite.settings["lidar"].mount_b == pytest.approx((0.0, 0.0, 0.21), abs=1e-3)
    simulation.close()


def test_a_path_is_asked_for():
    with pytest.raises(ConfigError, match=r"robot\.path is missing; give it a value"):
        compose_environment("flat", ["robot=urdf"])


def test_a_mount_in_the_ground_is_refused(tmp_path):
    path = write_cart(tmp_path)
    conf = compose_environment(
        "flat", ["robot=urdf", f"robot.path={path}", "sensors.lidar.mount_b=[0,0,-0.1]"]
    )
    with pytest.raises(ConfigError, match=r"sensors\.lidar\.mount_b lies in the ground"):
        make_simulation(conf, 1, 0)


def test_the_check_prints_what_is_derived_or_wrong(tmp_path, capsys):
    run([str(write_cart(tmp_path))])
    assert "left wheels: wheel_l_joint" in capsys.readouterr().out
    with pytest.raises(RobotError, match="there is no file"):
        run([str(tmp_path / "absent.urdf")])


def test_the_check_takes_settings_as_command_lines_do(tmp_path, capsys):
    path = str(write_cart(tmp_path))
    run([path, "robot.drive.max_torque_nm=7", "robot.mounts.imu_b=[0,0,1]"])
    out = capsys.readouterr().out
    assert "torque of a wheel: 7.00 Nm, as set" in out and "inertial unit at (0.0, 0.0, 1.0)" in out
    for words, told in (
        (
            ["robot.drive.kind=tank"],
            "robot.drive.kind must be one of auto, skid_steer, ackermann (got 'tank')",
        ),
        (["robot.drive.knd=auto"], "robot.drive.knd is not a setting; did you mean robot.drive.kind?"),
        (["robot.left_wheel=[a]"], "robot.left_wheel is not a setting; did you mean robot.left_wheels?"),
        (["zzz=1"], "robot.zzz is not a setting; robot has name, "),
        (["robot.drive=3"], "robot.drive must be a section with settings of its own (got 3)"),
        (["robot.left_wheels=[a"], "robot.left_wheels=[a: while parsing"),
        (["tank"], "usage: python -m dune_rl.robots FILE.urdf"),
    ):
        with pytest.raises(ConfigError) as caught:
            run([path, *words])
        assert told in str(caught.value)
