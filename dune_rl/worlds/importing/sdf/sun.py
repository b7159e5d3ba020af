"""The sun of an SDF file: its directional light."""

from xml.etree.ElementTree import Element

import numpy as np

from dune_rl.core.untrusted_files import ImportReport, printable
from dune_rl.geometry.arrays import Array
from dune_rl.rendering.light import LightConf
from dune_rl.worlds.importing.sdf.shapes import parse_numbers

Colour = tuple[float, float, float]


def parse_sun(element: Element, turn: Array, report: ImportReport) -> LightConf | None:
    """The sun of a <light> with orientation `turn` (3, 3); None, with a warning, if it shines upwards."""
    to_sun = -turn @ parse_numbers(element.find("direction"), 3, (0, 0, -1))
    length = float(np.linalg.norm(to_sun))
    if length < 1e-9 or to_sun[2] / length < 0.02:
        report.warn("its directional light does not come from above and is left out")
        return None
    return LightConf(
        sun_bearing_deg=float(np.rad2deg(np.arctan2(to_sun[1], to_sun[0]))),
        sun_elevation_deg=float(np.clip(np.rad2deg(np.arcsin(to_sun[2] / length)), 1.0, 90.0)),
        shadows=(element.findtext("cast_shadows") or "true").strip() in ("true", "1"),
        sun_colour=_colour(element, report),
    )


def _colour(element: Element, report: ImportReport) -> Colour:
    words = (element.findtext("diffuse") or "1 1 1").split()
    try:
        red, green, blue = (float(np.clip(float(word), 0.0, 1.0)) for word in words[:3])
        if np.isfinite([red, green, blue]).all() and max(red, green, blue) > 0.0:
            return red, green, blue
    except ValueError:
        pass
    report.warn(f"<diffuse> of its sun, {printable(' '.join(words), 40)!r}, is no colour of a light")
    return 1.0, 1.0, 1.0
