"""One Hydra session: where it looks for options, and the plain settings that it composes."""

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import yaml
from hydra import compose as hydra_compose
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton
from hydra.errors import HydraException
from hydra.version import setbase
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dune_rl.config.overrides import ParsedOverrides, offer_user_parts, stored_options, sweep_values
from dune_rl.core import paths
from dune_rl.core.errors import ConfigError
from dune_rl.core.untrusted_files import YamlLimitError, parse_yaml, printable

_MOST_BRACKETS = 200
# The groups of options that choose options of other groups, and change any settings.
WHOLE_SETTINGS = ("experiment", "scenario")


@contextmanager
def hydra_session(config_dirs: Sequence[str] = ()) -> Iterator[ConfigLoader]:
    """Hydra, initialised with our options, those of `config_dirs` and users' parts; then as it was before."""
    for folder in config_dirs:
        if not Path(folder).is_dir():
            raise ConfigError(f"there is no folder {folder} to read configurations from (--config-dir)")
        _check_files(Path(folder))
    # A process has one Hydra, which a caller may be using.
    before = Singleton.get_state() if GlobalHydra.instance().is_initialized() else None
    GlobalHydra.instance().clear()
    try:
        # Not `initialize_config_dir`, which searches one folder only.
        setbase("1.3")
        search_path = create_config_search_path(str(paths.conf_folder()))
        offer_user_parts(config_dirs)
        OmegaConf.register_new_resolver(
            "config_dir", partial(_find_in_folders, tuple(config_dirs)), replace=True
        )
        for folder in config_dirs:
            search_path.prepend("command-line", f"file://{Path(folder).resolve()}")
        yield Hydra.create_main_hydra2("dune_rl", search_path).config_loader
    except yaml.YAMLError as error:
        raise ConfigError(f"a file of settings is no valid YAML: {' '.join(str(error).split())}") from None
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(f"cannot compose the settings: {str(error).splitlines()[0]}") from None
    except RecursionError:
        raise ConfigError("cannot compose the settings: they are nested too deeply") from None
    except OSError as error:
        # Of an option of so long a name.
        if error.errno != errno.ENAMETOOLONG:
            raise
        name = printable(Path(str(error.filename)).stem)
        raise ConfigError(f"cannot compose the settings: there is no option {name}") from None
    finally:
        GlobalHydra.instance().clear()
        if before is not None:
            Singleton.set_state(before)


def _check_files(folder: Path) -> None:
    """Raise ConfigError for a file of options that Hydra could not read in any time."""
    for path in _option_files(folder):
        # What else is wrong with a file is told where an option of it is chosen.
        with suppress(OSError):
            state = path.stat()
            if fault := _fault_of_file(path, state.st_mtime_ns, state.st_size):
                raise ConfigError(f"{path} cannot be read: {fault}")


def _option_files(folder: Path) -> Iterator[Path]:
    """The YAML files in a folder and those below it, hidden ones left out."""
    for path, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (Path(path, file) for file in files if file.endswith((".yaml", ".yml")))


@lru_cache(maxsize=1024)
def _fault_of_file(path: Path, _changed_ns: int, _size: int) -> str | None:
    data = path.read_bytes()
    # A folder may hold the settings of thousands of runs: parsed is what may grow or nest without end.
    if not (b"&" in data and b"*" in data) and data.count(b"{") + data.count(b"[") <= _MOST_BRACKETS:
        return None
    try:
        parse_yaml(data)
    except YamlLimitError as error:
        return str(error)
    except ValueError:
        pass
    return None


def _find_in_folders(folders: Sequence[str], name: str) -> str:
    """The absolute path of a file in the user's folders of options: the value of `${config_dir:name}`."""
    for folder in folders:
        path = Path(folder).resolve() / name
        if path.exists():
            return str(path)
    where = " or ".join(folders) or "a folder of options (--config-dir)"
    raise ConfigError(f"there is no file {name} in {where}")


def compose_config(name: str, request: ParsedOverrides) -> DictConfig:
    """What Hydra composes of the file `name` and the overrides, read-only; `ConfigError` where it refuses."""
    try:
        return compose_words(name, request.hydra_words(present_groups(name, request)))
    except (HydraException, OmegaConfBaseException) as error:
        # Hydra's first line says in which file, and OmegaConf's, the next, what is wrong.
        first, *others = str(error).splitlines()
        reason = f"{first} {others[0]}" if others and first.endswith(":") else first
        raise ConfigError("\n".join([*request.faults, f"cannot compose the settings: {reason}"])) from None
    except (TypeError, ValueError):
        # OmegaConf looks for a name in a list.
        given = (str(each.input_line) for each in request.values)
        words = " ".join(word for word in given if not word.startswith("++"))
        reason = "cannot change a setting inside of a list; write the whole value, or one of the two"
        raise ConfigError("\n".join([*request.faults, f"{reason}: {words}"])) from None


def compose_words(name: str, words: Sequence[str] = ()) -> DictConfig:
    """What Hydra composes of the file `name` and overrides in its own form, read-only.

    Hydra reads dozens of files for it, which takes 0.2 s, so that it is composed once while none changes.
    """
    return _compose_words(name, tuple(words), _state_of_sources())


@lru_cache(maxsize=64)
def _compose_words(name: str, words: tuple[str, ...], _state: object) -> DictConfig:
    config = hydra_compose(name, list(words))
    OmegaConf.set_readonly(config, True)
    return config


def _state_of_sources() -> tuple[object, ...]:
    """All that differs if Hydra would find other options: files of options, and stored options."""
    loader = GlobalHydra.instance().config_loader()
    # Looking through the folders takes milliseconds; a session does it once.
    if loader not in _files_of_session:
        _files_of_session[loader] = tuple(_file_states(loader))
    return stored_options(), _files_of_session[loader]


_files_of_session: WeakKeyDictionary[ConfigLoader, tuple[object, ...]] = WeakKeyDictionary()


def _file_states(loader: ConfigLoader) -> Iterator[object]:
    """The folders in which Hydra looks for options, and their files with times and sizes."""
    for source in loader.get_search_path().get_path():
        yield source.path
        folder = Path(str(source.path).removeprefix("file://"))
        for file in _option_files(folder):
            # A file that is gone by now is as good as none.
            with suppress(OSError):
                status = file.stat()
                yield file, status.st_mtime_ns, status.st_size


def present_groups(name: str, request: ParsedOverrides) -> frozenset[str]:
    """The groups that are in the defaults list already, with those of an experiment and of a scenario."""
    whole = [each for each in request.groups if each.key_or_group in WHOLE_SETTINGS and not each.is_delete()]
    words = tuple(f"+{each.key_or_group}={sweep_values(each)[0].value()}" for each in whole)
    try:
        # Groups of which a list of options is chosen are no choices of Hydra's.
        return frozenset[str]().union(
            *(_present_groups_of(name, each, _state_of_sources()) for each in {(), words})
        )
    except HydraException:
        if len(whole) < 2:
            raise
        chosen = " and ".join(str(each.input_line) for each in whole)
        raise ConfigError(f"{chosen} both choose a world: leave one of them out") from None


@lru_cache(maxsize=32)
def _present_groups_of(name: str, words: tuple[str, ...], _state: object) -> frozenset[str]:
    config = hydra_compose(name, list(words), return_hydra_config=True)
    choices = config.hydra.runtime.choices
    return frozenset(
        group for group in choices if group not in WHOLE_SETTINGS and not group.startswith("hydra/")
    )


def stated_keys(request: ParsedOverrides, present: frozenset[str]) -> set[str]:
    """The overridden settings that a YAML file states, which need no `++`."""
    config = compose_words(
        "train", replace(request, values=(), engine=()).hydra_words(present, first_of_sweep=True)
    )
    keys = {override.key_or_group for override in request.values}
    return {key for key in keys if OmegaConf.select(config, key, default=config) is not config}


def to_plain(config: DictConfig) -> dict[str, Any]:
    """The settings as plain containers, with interpolations resolved."""
    try:
        data = OmegaConf.to_container(config, resolve=True)
    except OmegaConfBaseException as error:
        raise ConfigError(f"cannot resolve the settings: {str(error).splitlines()[0]}") from None
    assert isinstance(data, dict)
    return {str(key): value for key, value in data.items()}
