"""The <actor>s of SDF files for tests, in the shape of Gazebo's own examples."""


def way_point(time: float, x: float, y: float, yaw: float = 0.0, z: float = 1.0) -> str:
    return f"<waypoint><time>{time}</time><pose>{x} {y} {z} 0 0 {yaw}</pose></waypoint>"


def actor(name: str, *way_points: str, script: str = "", more: str = "") -> str:
    """An actor with a walking skin, one trajectory, and further elements of its script and its own."""
    skin = "<skin><filename>walk.dae</filename><scale>1.0</scale></skin>"
    walking = '<animation name="walking"><filename>walk.dae</filename></animation>'
    trajectory = f'<trajectory id="0" type="walking" tension="0.6">{"".join(way_points)}</trajectory>'
    script = f"<script>{script}{trajectory if way_points else ''}</script>"
    return f'<actor name="{name}"><pose>9 9 1 0 0 0</pose>{skin}{walking}{script}{more}</actor>'


def line(start: float, end: float, y: float) -> tuple[str, ...]:
    """Way-points along x at 1 m/s, so close that Gazebo's spline between them is straight."""
    count = round(abs(end - start) / 0.05)
    return tuple(way_point(0.05 * k, start + (end - start) * k / count, y) for k in range(count + 1))


SQUARE = (
    way_point(0, 2, 2),
    way_point(4, 6, 2),
    way_point(6, 6, 2, 1.5707963),
    way_point(10, 6, 6, 1.5707963),
    way_point(14, 2, 6, 3.1415926),
    way_point(18, 2, 2, -1.5707963),
)
