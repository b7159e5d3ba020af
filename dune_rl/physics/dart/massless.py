"""Bodies of a DART skeleton that only carry collision shapes or joints."""

from typing import Any

import numpy as np

from dune_rl.physics.dart.library import dartpy

# DART refuses bodies without mass; this is as good as none.
_MASS_KG, _MOMENT_KGM2 = 1e-9, 1e-12


def negligible_inertia() -> Any:
    """Inertia of a body of as good as no mass."""
    return dartpy.dynamics.Inertia(_MASS_KG, np.zeros(3), _MOMENT_KGM2 * np.eye(3))


def weld_massless_body(link: Any) -> Any:
    """Weld a new body, of as good as no mass, to a link."""
    _, body = link.createWeldJointAndBodyNodePair()
    body.setInertia(negligible_inertia())
    return body
