"""Registry of kinematic bodies: built-in ones, those of packages, and those registered at run time."""

import inspect
from typing import Any

from dune_rl.bodies.settings import BodySettings
from dune_rl.core.errors import RegistryError
from dune_rl.core.registry import Registry
from dune_rl.core.signatures import PartSignature

_FORM = "a subclass of dune_rl.bodies.settings.BodySettings whose fields all have defaults"


class BodyRegistry(Registry[BodySettings]):
    """The bodies by name: a part is a settings class itself, which needs no function to make it."""

    @property
    def entry_point_group(self) -> str:
        """The entry-point group in which packages add bodies."""
        return "dune_rl.bodies"

    def _signature_of(self, target: Any, name: str, origin: str) -> PartSignature:
        if not (inspect.isclass(target) and issubclass(target, BodySettings)):
            raise self._error(f"{origin}, which must be {_FORM}, and is {target!r}.")
        needed = [
            key for key, field in target.model_fields.items() if field.is_required() and key != self.tag
        ]
        if needed:
            raise self._error(f"{origin}, which must be {_FORM}, and has none for {', '.join(needed)}.")
        return PartSignature(target, True, {}, None, target)


BODIES: BodyRegistry = BodyRegistry(
    "body",
    "dune_rl.bodies.registry:BODIES",
    own={
        "person": "dune_rl.bodies.person:PersonConf",
        "child": "dune_rl.bodies.person:ChildConf",
        "car": "dune_rl.bodies.vehicles:CarConf",
        "truck": "dune_rl.bodies.vehicles:TruckConf",
        "tractor": "dune_rl.bodies.vehicles:TractorConf",
        "cow": "dune_rl.bodies.animals:CowConf",
        "sheep": "dune_rl.bodies.animals:SheepConf",
        "dog": "dune_rl.bodies.animals:DogConf",
        "drone": "dune_rl.bodies.drone:DroneConf",
    },
    base=BodySettings,
    product=BodySettings,
    form=_FORM,
    class_leading=(),
    error=RegistryError,
)
