"""URDFs to try: a differential platform of a package, with casters, frames without mass and meshes."""

from pathlib import Path

import trimesh

CART = """<?xml version="1.0"?>
<robot name="cart">
  <material name="red"><color rgba="0.8 0.1 0.1 1"/></material>
  <link name="base_footprint"/>
  <joint name="base_joint" type="fixed"><parent link="base_footprint"/><child link="base_link"/>
    <origin xyz="0 0 0.1"/></joint>
  <link name="base_link">
    <inertial><origin xyz="0.01 0 0.02"/><mass value="8"/>
      <inertia ixx="0.08" iyy="0.12" izz="0.15" ixy="0.001" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://cart_description/meshes/shell.obj" scale="0.001 0.001 0.001"/>
      </geometry><material name="red"/></visual>
    <collision><geometry><mesh filename="package://cart_description/meshes/shell.obj"
      scale="0.001 0.001 0.001"/></geometry></collision>
  </link>
  <link name="laser"/>
  <joint name="laser_joint" type="fixed"><parent link="base_link"/><child link="laser"/>
    <origin xyz="0.1 0 0.1"/></joint>
  <link name="arm"><inertial><origin xyz="0 0 0.1"/><mass value="0.5"/>
    <inertia ixx="0.002" iyy="0.002" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="arm_joint" type="revolute"><parent link="base_link"/><child link="arm"/>
    <origin xyz="-0.1 0 0.08"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="1"/></joint>
  <link name="wheel_l"><inertial><mass value="0.5"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><cylinder radius="0.08" length="0.04"/></geometry></collision></link>
  <joint name="wheel_l_joint" type="continuous"><parent link="base_link"/><child link="wheel_l"/>
    <origin xyz="0.05 0.2 -0.02" rpy="-1.5707963 0 0"/><axis xyz="0 0 1"/>
    <limit effort="3" velocity="10"/></joint>
  <link name="wheel_r"><inertial><mass value="0.5"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><cylinder radius="0.08" length="0.04"/></geometry></collision></link>
  <joint name="wheel_r_joint" type="continuous"><parent link="base_link"/><child link="wheel_r"/>
    <origin xyz="0.05 -0.2 -0.02" rpy="1.5707963 0 0"/><axis xyz="0 0 1"/>
    <limit effort="3" velocity="10"/></joint>
  <link name="caster"><inertial><mass value="0.1"/>
    <inertia ixx="0.0001" iyy="0.0001" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.04"/></geometry></collision></link>
  <joint name="caster_joint" type="fixed"><parent link="base_link"/><child link="caster"/>
    <origin xyz="-0.15 0 -0.06"/></joint>
</robot>
"""


def write_cart(folder: Path, text: str = CART) -> Path:
    """The file, in its package `cart_description` with its mesh of millimetres."""
    package = folder / "cart_description"
    (package / "urdf").mkdir(parents=True, exist_ok=True)
    (package / "meshes").mkdir(exist_ok=True)
    (package / "package.xml").write_text("<package/>")
    shell = trimesh.creation.box((400.0, 300.0, 120.0))
    (package / "meshes" / "shell.obj").write_text(trimesh.exchange.obj.export_obj(shell))
    path = package / "urdf" / "cart.urdf"
    path.write_text(text)
    return path


# What breaks readers of numbers and names.
WORDS = (
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "-1e-308",
    "1e8",
    "",
    "../..",
    "/etc/passwd",
    "&lt;",
    "#",
    "1 2",
    "0 0 0",
)
