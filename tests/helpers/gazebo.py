"""Gazebo files for tests of their import."""

from pathlib import Path

PLANE = (
    '<model name="ground_plane"><static>true</static><link name="l"><collision name="c"><geometry><plane>'
    "<normal>0 0 1</normal><size>40 30</size></plane></geometry>{surface}</collision></link></model>"
)


GROUND = PLANE.format(surface="")


def sdf(*models: str) -> str:
    return f'<?xml version="1.0"?><sdf version="1.9"><world name="w">{"".join(models)}</world></sdf>'


def model(name: str, geometry: str, pose: str = "0 0 0 0 0 0", inside: str = "", static: str = "true") -> str:
    return (
        f'<model name="{name}"><static>{static}</static><pose>{pose}</pose><link name="l">'
        f'<collision name="c"><geometry>{geometry}</geometry></collision>{inside}</link></model>'
    )


def include(uri: str, pose: str = "0 0 0 0 0 0", name: str = "") -> str:
    named = f"<name>{name}</name>" if name else ""
    return f"<include><uri>{uri}</uri><pose>{pose}</pose>{named}</include>"


def write_model(folder: Path, name: str, body: str, config: bool = True) -> Path:
    own = folder / name
    own.mkdir(parents=True, exist_ok=True)
    (own / "model.sdf").write_text(f'<sdf version="1.7">{body}</sdf>')
    if config:
        (own / "model.config").write_text(
            f'<model><name>{name}</name><sdf version="1.5">old.sdf</sdf>'
            '<sdf version="1.7">model.sdf</sdf></model>'
        )
    return own
