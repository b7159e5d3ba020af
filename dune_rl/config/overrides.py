"""Overrides of the command line in Hydra's form, and the options of groups, users' parts among them."""

from collections.abc import Container, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.config_loader import ConfigLoader
from hydra.core.config_store import ConfigStore
from hydra.core.object_type import ObjectType
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep, Override, OverrideType, ValueType
from hydra.errors import HydraException

from dune_rl.core.errors import DuneError
from dune_rl.core.registry import Registry
from dune_rl.core.suggestions import closest, one_of, text_word, typed_word
from dune_rl.core.untrusted_files import printable
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
# Letters of a word that a message repeats.
_MOST_REPEATED = 200
# What Hydra's grammar makes of a value: a list, a section, a quoted text, a reference, a sweep.
_GRAMMAR = frozenset("[]{}\"'$\\,")


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


SCENARIO = "scenario"
_SENSORS = "sensors"
# The group of which several options can be chosen at once.
_SEVERAL = "actors"
_PLURAL = (_SEVERAL, _SENSORS)


@dataclass(frozen=True)
class ParsedOverrides:
    """Overrides by what they do, with the faults that are found before anything is composed.

    `groups` choose options ("world" to "flat"), `values` change settings, and
    `engine` are Hydra's own. A faulty override is in none of them.
    """

    groups: tuple[Override, ...]
    values: tuple[Override, ...]
    engine: tuple[Override, ...]
    faults: tuple[str, ...]
    faulty_groups: frozenset[str]

    @property
    def group_changes(self) -> list[Override]:
        """The overrides of agent groups and of settings in them, those of whole sections first."""
        changes = [each for each in self.values if _changes_group(each)]
        return sorted(changes, key=lambda each: str(each.key_or_group).count("."))

    def without_group_changes(self) -> "ParsedOverrides":
        """The overrides that Hydra composes: to Hydra an option's name is a text, which a change replaces."""
        return replace(self, values=tuple(each for each in self.values if not _changes_group(each)))

    def chosen(self) -> set[str]:
        """The groups of options, and the settings of whole groups, that are chosen."""
        return {str(each.key_or_group) for each in (*self.groups, *self.values)}

    @property
    def has_scenario(self) -> bool:
        return any(each.key_or_group == SCENARIO for each in self.groups)

    def overridden_keys(self, section: str) -> set[str]:
        """The parts of a section that an override changes, such as the groups of `actors`."""
        keys = (str(override.key_or_group).split(".") for override in self.values)
        return {key[1] for key in keys if key[0] == section and len(key) > 1}

    def hydra_words(
        self, present: Iterable[str], *, stated: Iterable[str] = (), first_of_sweep: bool = False
    ) -> list[str]:
        """The overrides in Hydra's own form, with the groups that are `present` in its defaults list.

        Settings that are not `stated` in YAML get the prefix `++`: Hydra reports one unknown setting at a
        time, and the schema reports all of them together. A sweep is kept, or replaced by its first value.
        """
        words = [_hydra_word(override, "", first_of_sweep) for override in self.engine]
        for override in self.groups:
            prefix = "" if override.get_key_element().lstrip("+~") in present else "+"
            words.append(_hydra_word(override, prefix, first_of_sweep))
        for override in self.values:
            words.append(
                _hydra_word(override, "" if override.key_or_group in stated else "++", first_of_sweep)
            )
        return words


def parse_override(parser: OverridesParser, word: str, texts: Container[str]) -> Override:
    """The override that a word is; raises HydraException or ValueError where it is none.

    A value is a text, without quotes, where Hydra's grammar has no place for it ("monde été"), and in one of
    the settings `texts`, in which the grammar reads a number ("2024_01").
    """
    key, _, value = word.partition("=")
    quoted = text_word(key, value.strip())
    try:
        override = parser.parse_override(word)
    except (HydraException, ValueError):
        if not value.strip() or _GRAMMAR & set(value):
            raise
        return parser.parse_override(quoted)
    is_number = override.value_type is ValueType.ELEMENT and isinstance(override.value(), bool | int | float)
    return parser.parse_override(quoted) if is_number and override.key_or_group in texts else override


def parse_overrides(
    overrides: Sequence[str], loader: ConfigLoader, texts: Container[str] = ()
) -> ParsedOverrides:
    """Parse overrides and sort them by what they do; unreadable and unknown ones become faults.

    `texts` are the settings of the top level that are texts.
    """
    parser = OverridesParser.create(config_loader=loader)
    folders = group_names(loader)
    groups: list[Override] = []
    values: list[Override] = []
    engine: list[Override] = []
    faults: list[str] = []
    faulty_groups: set[str] = set()
    for text in overrides:
        try:
            override = parse_override(parser, text, texts)
        # Python refuses numbers of thousands of digits.
        except (HydraException, ValueError):
            faults.append(_describe_unreadable(text))
            continue
        key = override.key_or_group
        if key == _SENSORS and text.partition("=")[2].startswith("["):
            # A list is of sensors; the group's options are whole sets of settings.
            override = parser.parse_override(f"{_SENSORS}.enabled={text.partition('=')[2]}")
            key = override.key_or_group
        if override.is_hydra_override() or key.startswith("hydra."):
            engine.append(override)
        elif key in folders and not isinstance(override.value(), dict):
            found = _option_faults(override, loader)
            faults += found
            (faulty_groups.add(key) if found else groups.append(override))
        elif "/" in key:
            faults.append(f"there is no group {key!r}; choose from {', '.join(folders)}")
        else:
            values.append(override)
    return ParsedOverrides(
        tuple(groups), tuple(values), tuple(engine), tuple(faults), frozenset(faulty_groups)
    )


def group_names(loader: ConfigLoader) -> list[str]:
    """The folders of options: world, robot, ..."""
    names = _names_in(loader, "", ObjectType.GROUP)
    # Other libraries in this process may have registered groups of theirs, which have no folder.
    return [name for name in names if name != "hydra" and _has_folder(loader, name)]


def _has_folder(loader: ConfigLoader, group: str) -> bool:
    sources = (str(source.path).removeprefix("file://") for source in loader.get_search_path().get_path())
    return any((Path(folder) / group).is_dir() for folder in sources)


def option_names(loader: ConfigLoader, group: str) -> list[str]:
    """The options of a group: flat, inspection, ..."""
    return sorted(_names_in(loader, group, ObjectType.CONFIG))


def _names_in(loader: ConfigLoader, group: str, kind: ObjectType) -> list[str]:
    # Not `loader.get_group_options`, which copies all that it knows at each call: 15 ms.
    assert isinstance(loader, ConfigLoaderImpl)
    return loader.repository.get_group_options(group, kind)


def sweep_values(override: Override) -> list[Override]:
    """An override for each value of a swept one; the override itself where it has one value."""
    if not override.is_sweep_override():
        return [override]
    key = override.get_key_element()
    parser = OverridesParser.create()
    interval = override.value()
    if isinstance(interval, IntervalSweep):
        # Its values lie between the two that it has.
        return [parser.parse_override(f"{key}={value}") for value in (interval.start, interval.end)]
    return [parser.parse_override(f"{key}={value}") for value in override.sweep_string_iterator()]


def _changes_group(override: Override) -> bool:
    section, _, rest = str(override.key_or_group).partition(".")
    return section in ("agents", "actors") and bool(rest) and not override.is_delete()


def _option_faults(override: Override, loader: ConfigLoader) -> list[str]:
    group = override.key_or_group
    if override.is_delete():
        return []
    options = option_names(loader, group)
    chosen: list[object] = []
    for single in sweep_values(override):
        value = single.value()
        if value is None or (isinstance(value, list) and group != _SEVERAL):
            return [f"{group} must be the name of an option: choose {one_of(options)}, or leave it out"]
        chosen += value if isinstance(value, list) else [value]
    found = []
    for option in chosen:
        load_user_part(group, str(option))
        if option not in options:
            near = closest(str(option), options)
            hint = f"did you mean {near}?" if near and len(options) > 6 else f"choose {one_of(options)}"
            none = "are no" if group in _PLURAL else "is no"
            found.append(f"there {none} {group} {str(option)!r}; {hint}")
    return found


def _describe_unreadable(text: str) -> str:
    if "=" not in text:
        is_path = len(text) <= _MOST_REPEATED and Path(text).exists()
        where = (
            f"; a file or folder goes behind a key, such as {typed_word('resume', text)}" if is_path else ""
        )
        return f"cannot read {printable(text, _MOST_REPEATED)!r}; write key=value{where}"
    key = printable(text.partition("=")[0], _MOST_REPEATED)
    return (
        f"cannot read {printable(text, _MOST_REPEATED)!r}; write key=value, and quote a value that holds "
        f"commas, brackets, quotes or backslashes: '{key}=\"...\"'"
    )


def _hydra_word(override: Override, prefix: str, first_of_sweep: bool) -> str:
    if first_of_sweep:
        override = sweep_values(override)[0]
    if override.type is OverrideType.DEL or override.is_hydra_override():
        return override.input_line or ""
    key = override.get_key_element().lstrip("+")
    if override.is_sweep_override():
        return f"{prefix}{key}={(override.input_line or '').partition('=')[2]}"
    return f"{prefix}{key}={override.get_value_element_as_str()}"
