"""The group `world`: its settings by their name, and users' worlds among its options."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from hydra.core.config_store import ConfigStore
from pydantic import BeforeValidator, SerializeAsAny

from dune_rl.errors import WorldError
from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.settings import WorldSettings

GROUP = "world"
_PROVIDER = "dune_rl"


WorldConf = Annotated[SerializeAsAny[WorldSettings], BeforeValidator(WORLDS.parse_settings)]


def offer(folders: Sequence[str] = ()) -> None:
    """Make users' worlds options of Hydra's, save those that a file in `folders` stands for.

    A package is not imported for it, so that of its world only the name is
    stated; the schema knows the rest.
    """
    store = ConfigStore.instance()
    options: dict[str, Any] = store.repo.setdefault(GROUP, {})
    for file in [file for file, node in options.items() if node.provider == _PROVIDER]:
        del options[file]
    for name in WORLDS.user_names():
        if not any((Path(folder) / GROUP / f"{name}.yaml").is_file() for folder in folders):
            store.store(name, _stated(name), group=GROUP, provider=_PROVIDER)


def state(name: str) -> None:
    """Have the option of a user's world, now that it is chosen, state its defaults."""
    options = ConfigStore.instance().repo.get(GROUP, {})
    if f"{name}.yaml" not in options or WORLDS.is_loaded(name):
        return
    # What is wrong with a package is said once, when its settings are checked.
    with suppress(WorldError):
        WORLDS.settings_class(name)
        ConfigStore.instance().store(name, _stated(name), group=GROUP, provider=_PROVIDER)


def _stated(name: str) -> dict[str, Any]:
    settings = WORLDS.settings_class(name) if WORLDS.is_loaded(name) else None
    if settings is None:
        return {"name": name}
    given = {key for key, field in settings.model_fields.items() if not field.is_required()}
    values = {key: settings.model_fields[key].get_default(call_default_factory=True) for key in given}
    return settings.model_construct(**values).model_dump(mode="json", include=given)
