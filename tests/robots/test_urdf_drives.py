"""Drives of robots from URDFs: torques that turn heavy ones, casters, and drives that are refused by name."""

import numpy as np
import pytest
from scenes import STEP_S, Drive, every_backend
from vehicles import (
    box_link,
    caster_pitch,
    joint,
    rolling,
    small_link,
    transmission,
    wheel_link,
    write,
    write_car,
    write_caster_robot,
    write_four_wheeler,
    write_rocker_bogie,
)

from dune_rl.core.errors import RobotError
from dune_rl.geometry.frames import roll_pitch_yaw
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.meshes import RobotWarning
from dune_rl.robots.urdf.robot import UrdfRobot
from dune_rl.robots.visual import RobotVisual

GRAVITY_MPS2 = 9.81


def read(path, **settings):
    return UrdfRobot(UrdfConf(path=str(path), **settings), 1)


def drive(robot, backend):
    return Drive(backend, rover=robot, position_w=(0.0, 0.0, robot.description.standing_height_m + 0.003))


# -- torque --------------------------------------------------------------------------------------


def test_the_torque_follows_from_mass_grip_and_geometry(tmp_path):
    # Wheels scrub along their axles with mu m g in all, at 0.256 m before and behind the middle.
    robot = read(write_four_wheeler(tmp_path))
    force = robot.description.mass_kg * GRAVITY_MPS2 / 4 * 0.256 / 0.2854
    assert robot.drive.max_torque_nm == pytest.approx(2.0 * force * 0.1651, rel=0.01)
    assert (
        "assumed (the URDF has no effort limit): enough to turn on the spot with 56.4 kg at friction 1"
        in (robot.summary())
    )
    # Longer than wide, it takes the whole grip.
    long = read(write_four_wheeler(tmp_path, x_m=0.5))
    assert long.drive.max_torque_nm == pytest.approx(
        2 * long.description.mass_kg * GRAVITY_MPS2 / 4 * 0.1651, rel=0.01
    )
    half = read(write_four_wheeler(tmp_path, x_m=0.5), wheel_friction=0.8)
    assert half.drive.max_torque_nm == pytest.approx(0.8 * long.drive.max_torque_nm)


def test_limits_in_the_urdf_count_unless_they_are_none(tmp_path):
    path = write_four_wheeler(tmp_path)
    derived = read(path).drive.max_torque_nm
    text = path.read_text()
    for effort, torque in (("30", 30.0), ("100000", derived), ("0", derived)):
        path.write_text(text.replace("</joint>", f'<limit effort="{effort}" velocity="10"/></joint>'))
        assert read(path).drive.max_torque_nm == torque
    path.write_text(text.replace("</joint>", '<limit effort="5" velocity="10"/></joint>'))
    assert "too little to turn on the spot at friction 1" in read(path).summary()
    assert read(path, drive={"max_torque_nm": 12.0}).drive.max_torque_nm == 12.0


def rate_on_the_spot(robot, backend):
    driven = drive(robot, backend)
    yaws = []
    for _ in range(120):
        # A yaw rate of 1 rad/s, with the gains as they are.
        driven.step(0.0, 0.5)
        yaws.append(driven.stage.yaw)
    yaws = np.unwrap(yaws)
    return (yaws[-1] - yaws[40]) / (79 * STEP_S)


@every_backend
@pytest.mark.parametrize("robot", ["husky", "six wheels on levers", "six rigid wheels"])
def test_heavy_robots_turn_on_the_spot_as_fast_as_commanded(backend, robot, tmp_path):
    if robot == "husky":
        read_robot = read(write_four_wheeler(tmp_path))
    else:
        path = write_rocker_bogie(tmp_path, corners_steer=False, pivot_m=0.05)
        read_robot = read(path, **({} if "levers" in robot else {"free_joints": ()}))
    assert rate_on_the_spot(read_robot, backend) == pytest.approx(1.0, rel=0.1)


@every_backend
def test_what_turns_on_the_spot_takes_more_than_a_climb(backend, tmp_path):
    # The torque that holds the whole weight on a wall, which was the default, does not do.
    climbing = 56.4 * GRAVITY_MPS2 * 0.1651 / 4
    robot = read(write_four_wheeler(tmp_path), drive={"max_torque_nm": 0.7 * climbing})
    assert rate_on_the_spot(robot, backend) < 0.9


# -- casters -------------------------------------------------------------------------------------


@pytest.mark.slow(all_but=["cylinder-*", "sphere-0.008-True-*"])
@every_backend
@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize(("shape", "radius_m"), [("sphere", 0.03), ("sphere", 0.008), ("cylinder", 0.03)])
def test_a_caster_below_the_wheels_tilts_a_robot_by_geometry(backend, shape, radius_m, fixed, tmp_path):
    named = {"left_wheels": ("left_wheel_joint",), "right_wheels": ("right_wheel_joint",)}
    pitches = []
    for depth_m in (0.0, 0.015):
        path = write_caster_robot(tmp_path, depth_m, shape=shape, radius_m=radius_m, fixed=fixed)
        driven = drive(read(path, **({} if fixed else named)), backend)
        for _ in range(40):
            driven.step(0.0, 0.0)
        pitches.append(float(roll_pitch_yaw(driven.stage.rotation)[1]))
        # Wheels yield by 1 mm in DART, and hulls stand off the ground by 2 mm in PyBullet, over 0.3 m.
        assert pitches[-1] == pytest.approx(caster_pitch(depth_m, radius_m), abs=np.deg2rad(0.55))
    assert pitches[1] - pitches[0] == pytest.approx(caster_pitch(0.015, radius_m), abs=np.deg2rad(0.2))


def test_a_swivel_caster_is_told_from_steering(tmp_path):
    def robot(trail_m, name, *extra):
        return write(
            tmp_path,
            "carrier",
            box_link("base_link", 8.0, (0.5, 0.3, 0.1), "0 0 0.05"),
            *(wheel_link(f"{side}_wheel", 0.5, 0.08, 0.04) for side in ("left", "right")),
            rolling("left_wheel", "base_link", (0.15, 0.2, 0.0)),
            rolling("right_wheel", "base_link", (0.15, -0.2, 0.0)),
            small_link(name, 0.2),
            joint(f"{name}_joint", "base_link", name, (-0.2, 0.0, 0.05), "continuous", "0 0 1"),
            wheel_link("small_wheel", 0.2, 0.04, 0.03),
            rolling("small_wheel", name, (-trail_m, 0.0, -0.09)),
            *extra,
        )

    caster = read(robot(0.03, "caster_fork"))
    assert caster.steering is None
    assert caster.body.drive_joints == ("left_wheel_joint", "right_wheel_joint")
    # The same joint steers if a controller commands it and its wheel does not trail.
    tricycle = read(robot(0.0, "fork", transmission("fork_joint")))
    assert tricycle.body.drive_joints == ("left_wheel_joint", "right_wheel_joint", "fork_joint")


# -- refusals ------------------------------------------------------------------------------------

PLANAR_MOVE = '<gazebo><plugin name="move" filename="libgazebo_ros_planar_move.so"/></gazebo>'
DIAGONAL = "".join(
    f'<gazebo reference="{end}_{side}_wheel"><mu1>1</mu1><mu2>0</mu2><fdir1>1 {sign} 0</fdir1></gazebo>'
    for end, side, sign in (
        ("front", "left", -1),
        ("front", "right", 1),
        ("rear", "left", 1),
        ("rear", "right", -1),
    )
)


def rollers(parent):
    return "".join(
        wheel_link(f"{parent}_roller_{number}", 0.01, 0.01, 0.01)
        + rolling(f"{parent}_roller_{number}", parent, (0.0, 0.0, 0.05))
        for number in range(6)
    )


def fixed(link):
    return joint(f"{link}_joint", "base_link", link, (0.0, 0.0, 0.3), "fixed", "0 0 1")


@pytest.mark.parametrize(
    ("settings", "extra", "sign"),
    [
        ({}, PLANAR_MOVE, r"plugin move|plugin libgazebo_ros_planar_move\.so"),
        ({}, DIAGONAL, "fdir1 along a diagonal on link front_left_wheel"),
        ({}, rollers("front_left_wheel"), "rollers on link front_left_wheel"),
        ({"wheel": "mecanum_{end}_{side}"}, "", "wheels called mecanum_front_left"),
        ({"wheel": "{end}_{side}_omni_wheel"}, "", "wheels called front_left_omni_wheel"),
    ],
)
def test_mecanum_wheels_are_refused_by_name(tmp_path, settings, extra, sign):
    path = write_four_wheeler(tmp_path, extra, name="slider", **settings)
    with pytest.raises(
        RobotError, match=rf"slider\.urdf: the robot has mecanum.*{sign}.*not supported"
    ) as told:
        read(path)
    assert "robot.drive.kind=skid_steer" in str(told.value)
    assert len(read(path, drive={"kind": "skid_steer"}).body.drive_joints) == 4


@pytest.mark.parametrize(
    ("settings", "extra"),
    [
        ({"name": "omnibot"}, ""),
        ({"name": "mecanum"}, ""),
        ({}, small_link("omni_camera") + fixed("omni_camera")),
        ({}, small_link("track_width") + fixed("track_width")),
        ({}, box_link("track", 0.1, (0.1, 0.1, 0.02)) + fixed("track")),
        ({}, '<gazebo reference="front_left_wheel"><fdir1 value="1 0 0"/></gazebo>'),
        ({}, '<gazebo><plugin name="omniscient" filename="liblaser.so"/></gazebo>'),
    ],
)  # fmt: skip
def test_one_unlucky_name_is_no_reason(tmp_path, settings, extra):
    robot = read(write_four_wheeler(tmp_path, extra, **settings))
    assert robot.steering is None and len(robot.body.drive_joints) == 4


def test_wheels_whose_rollers_alone_collide_are_recognised(tmp_path):
    path = write_four_wheeler(tmp_path, *(rollers(f"{end}_left_wheel") for end in ("front", "rear")))
    text = path.read_text()
    for end in ("front", "rear"):
        start = text.index("<collision>", text.index(f'<link name="{end}_left_wheel">'))
        stop = text.index("</collision>", start) + len("</collision>")
        text = text[:start] + text[stop:]
    path.write_text(text)
    with pytest.raises(
        RobotError, match=r"mecanum or omnidirectional wheels \(rollers on link front_left_wh"
    ):
        read(path)


def test_wheels_in_a_star_are_omnidirectional(tmp_path):
    elements = [box_link("base_link", 8.0, (0.3, 0.3, 0.1), "0 0 0.1")]
    for number, bearing in enumerate(np.deg2rad([0.0, 120.0, 240.0])):
        c, s = np.cos(bearing), np.sin(bearing)
        place = f'<origin xyz="{0.2 * c} {0.2 * s} 0" rpy="0 0 {bearing - np.pi / 2}"/>'
        elements += [
            wheel_link(f"wheel_{number}", 0.3, 0.05, 0.03),
            f'<joint name="j{number}" type="continuous"><parent link="base_link"/>'
            f'<child link="wheel_{number}"/>{place}<axis xyz="0 1 0"/></joint>',
        ]
    with pytest.raises(RobotError, match=r"mecanum or omnidirectional.*3 wheels about axes in different"):
        read(write(tmp_path, "kiwi", *elements))


def test_tracks_are_refused_by_name(tmp_path):
    elements = [box_link("base_link", 20.0, (0.6, 0.3, 0.2), "0 0 0.1")]
    for side, y in (("left", 0.25), ("right", -0.25)):
        elements += [
            box_link(f"{side}_track", 3.0, (0.6, 0.1, 0.1)),
            joint(f"{side}_track_joint", "base_link", f"{side}_track", (0, y, 0), "fixed", "0 1 0"),
        ]
    with pytest.raises(
        RobotError, match=r"tank\.urdf: the robot has tracks \(link left_track, and no wheels"
    ):
        read(write(tmp_path, "tank", *elements))
    plugin = '<gazebo><plugin filename="gz-sim-tracked-vehicle-system" name="TrackedVehicle"/></gazebo>'
    path = write_four_wheeler(tmp_path, plugin)
    with pytest.raises(RobotError, match=r"the robot has tracks \(plugin"):
        read(path)
    assert len(read(path, drive={"kind": "skid_steer"}).body.drive_joints) == 4


def test_a_robot_whose_forward_axis_is_y_is_told_so(tmp_path):
    elements = [box_link("base_link", 8.0, (0.3, 0.5, 0.1), "0 0 0.1")]
    for number, (x, y) in enumerate(((0.2, 0.15), (-0.2, 0.15), (0.2, -0.15), (-0.2, -0.15))):
        elements += [
            wheel_link(f"w{number}", 0.5, 0.08, 0.04),
            f'<joint name="j{number}" type="continuous"><parent link="base_link"/><child link="w{number}"/>'
            f'<origin xyz="{x} {y} 0" rpy="0 0 1.5707963"/><axis xyz="0 1 0"/></joint>',
        ]
    with pytest.raises(
        RobotError, match=r"4 such joints turn about x: if y is its forward axis, turn the root"
    ):
        read(write(tmp_path, "sideways", *elements))


# -- meshes --------------------------------------------------------------------------------------


def test_a_missing_visual_mesh_is_a_warning_and_a_plain_shape(tmp_path):
    path = write_car(tmp_path)
    text = path.read_text()
    start = text.index("<visual>")
    end = text.index("</visual>")
    mesh = '<visual><geometry><mesh filename="meshes/absent.dae"/></geometry>'
    path.write_text(text[:start] + mesh + text[end:])
    with pytest.warns(
        RobotWarning, match=r"car\.urdf: link 'base_link' is drawn without.*absent\.dae is not in"
    ):
        robot = read(path)
    bodies = RobotVisual(robot.body.look).posed_meshes(np.zeros(3), np.eye(3))
    assert len(bodies) == 5
    # The body is drawn as the box by which it collides.
    sizes = [np.ptp(body.solid.shape.vertices, axis=0) for body in bodies]
    assert any(np.allclose(size, [0.7, 0.36, 0.12]) for size in sizes)
    path.write_text(text.replace('<box size="0.7 0.36 0.12"/>', '<mesh filename="meshes/absent.dae"/>', 1))
    with pytest.raises(
        RobotError, match=rf"link 'base_link': the mesh meshes/absent\.dae is not in {tmp_path}"
    ):
        read(path)


def test_the_hint_for_a_xacro_file_never_empties_it(tmp_path):
    path = tmp_path / "max.urdf"
    path.write_text('<robot><xacro:macro xmlns:xacro="http://www.ros.org/wiki/xacro" name="m"/></robot>')
    with pytest.raises(RobotError, match=r"xacro max\.urdf > max_expanded\.urdf$"):
        read(path)
