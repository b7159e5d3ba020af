"""Lookup of the files of Gazebo models: `model://` URIs, and paths relative to a file."""

import os
from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

from dune_rl.core.errors import WorldError
from dune_rl.core.file_dependencies import mark_incomplete, record_absent
from dune_rl.core.untrusted_files import (
    ImportReport,
    OutsideFolderError,
    WorldFiles,
    printable,
    read_bytes,
    read_xml,
)

RESOURCE_VARIABLE = "GZ_SIM_RESOURCE_PATH"

_MODEL_FILE_BYTES = 32 * 2**20
_NAMES = ("world.sdf", "model.sdf")


class SdfFileFinder:
    """Finds files by their URIs in the world's folder, and in the folders of GZ_SIM_RESOURCE_PATH.

    `model://NAME/...` may be in the world's own folder if that is named NAME, in the folder NAME or
    models/NAME in it, or in the folder NAME of a resource folder. Links that lead out of these are refused.
    """

    def __init__(self, folder: Path, report: ImportReport) -> None:
        self.folder = WorldFiles(folder)
        self._report = report
        self._resources = [
            Path(p).expanduser() for p in os.environ.get(RESOURCE_VARIABLE, "").split(":") if p
        ]
        self._xml: dict[Path, Element] = {}

    def find(self, uri: str, beside: WorldFiles) -> tuple[Path, WorldFiles] | None:
        """A file or folder, and the files that it may refer to; None, with a warning, if it is missing.

        Raises `OutsideFolderError` if the URI leads out of the permitted folders.
        """
        scheme, separator, rest = uri.strip().partition("://")
        if separator and scheme in ("model", "package"):
            found = self._find_model(rest)
        elif separator and scheme != "file":
            self._report.warn(
                f"{scheme}:// addresses are not supported: {printable(uri)} is left out; download its folder "
                "beside the file, and write model://FOLDER"
            )
            return None
        else:
            found = _find_inside(beside, rest if separator else uri.strip())
        if found is None:
            self._report.warn(
                f"{printable(uri)} is missing and left out; "
                f"put its folder beside the file, or into {RESOURCE_VARIABLE}"
            )
        return found

    def _find_model(self, rest: str) -> tuple[Path, WorldFiles] | None:
        name, _, inner = rest.replace("\\", "/").partition("/")
        if name in ("", ".", "..") or "\0" in rest:
            raise OutsideFolderError(f"model://{printable(rest)} names no model: use model://NAME/FILE.")
        own = [self.folder.root] if self.folder.root.name == name else []
        for root in (*own, self.folder.root / name, self.folder.root / "models" / name):
            if _is_folder(root):
                if not root.resolve().is_relative_to(self.folder.root):
                    raise OutsideFolderError(
                        f"{root} is a link that leads out of {self.folder.root}: it is not read."
                    )
                found = _find_inside(WorldFiles(root), inner)
                if found is not None:
                    return found
        for resource in self._resources:
            # A resource folder may itself be a link: the user put it there.
            if _is_folder(resource / name):
                found = _find_inside(WorldFiles(resource / name), inner)
                if found is not None:
                    return found
        return None

    def read_document(self, path: Path) -> Element:
        """The root element of an SDF file; each file is read once."""
        real = path.resolve()
        if real not in self._xml:
            root = read_xml(read_bytes(path, _MODEL_FILE_BYTES), path.name)
            if root.tag != "sdf":
                raise WorldError(
                    f"{path} is no SDF file: its root is <{printable(root.tag, 40)}>, not <sdf>."
                )
            self._xml[real] = root
        return self._xml[real]

    def find_description(self, folder: Path, within: WorldFiles) -> Path:
        """The SDF file of a model's or world's folder: the newest in model.config, or one of usual name."""
        names: list[str] = []
        config = folder / "model.config"
        if not config.is_file():
            record_absent(config)
        else:
            within.relative_to(folder).find("model.config")
            root = read_xml(read_bytes(config, _MODEL_FILE_BYTES), config.name)
            listed = [(_version(element), (element.text or "").strip()) for element in root.iter("sdf")]
            names = [name for _, name in sorted(listed, key=lambda item: item[0], reverse=True) if name]
        for name in (*names, *_NAMES):
            try:
                return within.relative_to(folder).find(name)
            except FileNotFoundError:
                continue
        mark_incomplete()
        found = sorted(p for ending in ("*.sdf", "*.world") for p in folder.glob(ending))
        if len(found) == 1:
            return within.relative_to(folder).find(found[0].name)
        listing = ", ".join(p.name for p in found[:8]) or "none"
        raise WorldError(
            f"{folder} has no model.sdf or world.sdf (of .sdf and .world: {listing}): name the file."
        )


def _find_inside(folder: WorldFiles, inner: str) -> tuple[Path, WorldFiles] | None:
    """A file or folder inside `folder`, or `folder` itself, with its files; None if it is missing."""
    try:
        path = folder.locate(inner)
    except FileNotFoundError:
        return None
    return path, WorldFiles(path.resolve()) if path.is_dir() else folder


def _is_folder(path: Path) -> bool:
    if path.is_dir():
        return True
    record_absent(path)
    return False


def _version(element: Element) -> tuple[int, ...]:
    words: Sequence[str] = (element.get("version") or "0").split(".")
    return tuple(int(word) if word.isdigit() else 0 for word in words[:3])
