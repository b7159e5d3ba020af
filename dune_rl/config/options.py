"""Options of groups that no YAML file states: the worlds, robots, engines and algorithms of users."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore

from dune_rl.core.errors import DuneError
from dune_rl.core.registry import Registry
from dune_rl.learning.registry import ALGORITHMS
from dune_rl.physics.interface import ENGINES
from dune_rl.robots.registry import ROBOTS
from dune_rl.worlds.registry import WORLDS

# The groups of options (folders of conf/) whose options are the parts of a registry.
REGISTRIES: Mapping[str, Registry[Any]] = {
    "world": WORLDS,
    "robot": ROBOTS,
    "physics": ENGINES,
    "learning": ALGORITHMS,
}
_PROVIDER = "dune_rl"


def offer_user_parts(folders: Sequence[str] = ()) -> None:
    """Make users' parts options of Hydra's, save those that a file in `folders` stands for.

    A package is not imported for it, so that only the name of its part is stated; the schema knows the rest.
    """
    for group, registry in REGISTRIES.items():
        store = ConfigStore.instance()
        options: dict[str, Any] = store.repo.setdefault(group, {})
        for file in [file for file, node in options.items() if node.provider == _PROVIDER]:
            del options[file]
        for name in registry.user_names():
            if not any((Path(folder) / group / f"{name}.yaml").is_file() for folder in folders):
                store.store(name, _stated_values(registry, name), group=group, provider=_PROVIDER)


def stored_options() -> str:
    """What users' parts state as options, to compare: equal where they state the same."""
    repo = ConfigStore.instance().repo
    stated = {
        f"{group}/{file}": node.node
        for group in REGISTRIES
        for file, node in repo.get(group, {}).items()
        if node.provider == _PROVIDER
    }
    return repr(stated)


def load_user_part(group: str, name: str) -> None:
    """Have the option of a user's part, now that it is chosen, state its defaults."""
    registry = REGISTRIES.get(group)
    options = ConfigStore.instance().repo.get(group, {})
    if registry is None or f"{name}.yaml" not in options or registry.is_loaded(name):
        return
    # What is wrong with a package is said once, when its settings are checked.
    with suppress(DuneError):
        registry.settings_class(name)
        stated = _stated_values(registry, name)
        ConfigStore.instance().store(name, stated, group=group, provider=_PROVIDER)


def _stated_values(registry: Registry[Any], name: str) -> dict[str, Any]:
    settings = registry.settings_class(name) if registry.is_loaded(name) else None
    if settings is None:
        return {registry.tag: name}
    given = {key for key, field in settings.model_fields.items() if not field.is_required()}
    values = {key: settings.model_fields[key].get_default(call_default_factory=True) for key in given}
    stated: dict[str, Any] = settings.model_construct(**values).model_dump(mode="json", include=given)
    return stated
