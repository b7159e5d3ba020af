"""Reading files from unknown sources: only within their folder, and within limits of size."""

import io
import itertools
import math
import os
import stat
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any
from xml.etree.ElementTree import Element, ParseError
from xml.etree.ElementTree import TreeBuilder as _TreeBuilder

import defusedxml
import numpy as np
import yaml
from defusedxml.ElementTree import DefusedXMLParser
from numpy.typing import NDArray
from PIL import Image

from dune_rl.core.errors import DuneWarning, WorldError
from dune_rl.core.file_dependencies import mark_incomplete, record_absent, record_read

MAX_FILE_BYTES = 256 * 2**20
MAX_FACES = 4_000_000

_MAX_XML_BYTES = 128 * 2**20
_MAX_XML_DEPTH = 128
_MAX_PIXELS = 64_000_000
_MOST_YAML_VALUES, _DEEPEST_YAML = 1_000_000, 200
_MOST_INTEGER_BITS = 1_024
# Largest side of a texture, and of one beyond the limit of all textures together.
_TEXTURE_PIXELS, _COARSE_PIXELS = 1024, 32
_MOST_TEXELS = 32_000_000

# Reports that an error repeats.
_MOST_REASONS = 4

Bytes = NDArray[np.uint8]


class WorldWarning(DuneWarning):
    """A part of an imported world that is missing or not supported."""


class ImportReport:
    """Collects the warnings of one import; equal texts are issued once.

    They are issued by `emit_warnings`, since warnings are silenced while libraries read the files. `hints`
    are settings to try if the world is not as expected.
    """

    def __init__(self, source: str) -> None:
        self.source = source
        self.texts: list[str] = []
        self.hints: dict[str, str] = {}
        self._texels = 0

    def warn(self, text: str) -> None:
        """Add a warning, unless there is an equal one."""
        if text not in self.texts:
            self.texts.append(text)

    def explain(self, fault: str) -> WorldError:
        """An error with the reasons that are known: what was left out, and what to try."""
        reasons = self.texts[:_MOST_REASONS]
        more = len(self.texts) - len(reasons)
        lines = [fault, *(f"{self.source}: {text}" for text in [*reasons, *self.hints.values()])]
        if more:
            lines.append(f"{self.source}: and {more} more such reports")
        return WorldError("\n".join(lines))

    def limit_texture(self, picture: Bytes) -> Bytes:
        """`picture` (rows, columns, 3), or a coarse copy once the limit of all textures is reached."""
        self._texels += picture.shape[0] * picture.shape[1]
        if self._texels <= _MOST_TEXELS:
            return picture
        self.warn(f"has more than {_MOST_TEXELS:,} texels of textures; further ones are coarse")
        image = Image.fromarray(picture)
        image.thumbnail((_COARSE_PIXELS, _COARSE_PIXELS))
        return np.asarray(image)

    def emit_warnings(self) -> None:
        """Issue the collected warnings, each preceded by the file's name."""
        texts, self.texts = self.texts, []
        for text in texts:
            warnings.warn(f"{self.source}: {text}", WorldWarning, stacklevel=3)


class OutsideFolderError(WorldError):
    """A name that leads out of the folder that a world may read."""

    def __init__(self, message: str) -> None:
        super().__init__(message)
        mark_incomplete()


class WorldFiles:
    """The files of a world: those below `root`, after resolving links; names are relative to `base`."""

    def __init__(self, root: Path, base: Path | None = None) -> None:
        self.root = root.resolve()
        self.base = root if base is None else base

    def relative_to(self, base: Path) -> "WorldFiles":
        return WorldFiles(self.root, base)

    def find(self, name: str) -> Path:
        """The path of a file; `OutsideFolderError` if outside `root`, `FileNotFoundError` if absent."""
        relative = name.strip().removeprefix("file://").replace("\\", "/")
        if "\0" in relative or not relative:
            raise FileNotFoundError(name)
        path = self.locate(relative)
        if not path.is_file():
            record_absent(path)
            raise FileNotFoundError(name)
        return path

    def locate(self, name: str) -> Path:
        """As `find`, of a file or a folder; `base` itself if `name` is empty."""
        path = Path(os.path.abspath(self.base / name)) if name else self.base
        try:
            real = path.resolve()
            if not real.is_relative_to(self.root):
                raise OutsideFolderError(
                    f"{printable(name)} leads out of the folder {self.root}: it is not read. "
                    "Copy what the world needs into that folder."
                )
            if real.is_dir() or real.is_file():
                return path
        # A name that no file can have.
        except (OSError, ValueError):
            pass
        record_absent(path)
        raise FileNotFoundError(name)

    def read(self, name: str) -> bytes:
        return read_bytes(self.find(name))


def resolve_world_path(path: str | Path) -> Path:
    """The setting `path` with `~` expanded; `WorldError` if nothing is there."""
    resolved = Path(path).expanduser()
    if not resolved.exists():
        raise WorldError(f"there is no file {resolved}: world.path must name one that exists.")
    return resolved


def read_bytes(path: Path, limit: int = MAX_FILE_BYTES) -> bytes:
    """The bytes of a regular file of at most `limit` bytes; `WorldError` for anything else."""
    try:
        state = path.stat()
        if not stat.S_ISREG(state.st_mode):
            raise WorldError(f"{path} is no plain file: world.path must name one.")
        if state.st_size > limit:
            raise WorldError(
                f"{path} has {state.st_size / 2**20:,.0f} MiB, and at most {limit / 2**20:.0f} are read: "
                "export it with fewer triangles or pixels."
            )
        with path.open("rb") as file:
            data = file.read(limit)
    except OSError as error:
        raise WorldError(f"{path} cannot be read: {error.strerror or error}.") from None
    record_read(path, data)
    return data


class _DepthLimitedBuilder(_TreeBuilder):
    # Trees deeper than those of real files would overflow the stack of recursive functions.
    def __init__(self) -> None:
        super().__init__()
        self._depth = 0

    def start(self, tag: Any, attributes: Any) -> Any:
        self._depth += 1
        if self._depth > _MAX_XML_DEPTH:
            raise WorldError(f"its elements are nested more than {_MAX_XML_DEPTH} deep")
        return super().start(tag, attributes)

    def end(self, tag: Any) -> Any:
        self._depth -= 1
        return super().end(tag)


def read_xml(data: bytes, name: str) -> Element:
    """The root element of an XML text; `WorldError` if it is invalid, or has entities or external parts."""
    if len(data) > _MAX_XML_BYTES:
        raise WorldError(
            f"{name} has {len(data) / 2**20:,.0f} MiB of XML, and at most {_MAX_XML_BYTES / 2**20:.0f} are "
            "read: export it with fewer triangles, or as GLB."
        )
    parser = DefusedXMLParser(
        target=_DepthLimitedBuilder(), forbid_dtd=False, forbid_entities=True, forbid_external=True
    )
    try:
        parser.feed(data)
        root: Element = parser.close()
    except defusedxml.DefusedXmlException:
        raise WorldError(
            f"{name} declares XML entities or refers to external ones, which are not read: "
            "remove its DOCTYPE."
        ) from None
    except WorldError as error:
        raise WorldError(f"{name} is not read: {error}.") from None
    except (ParseError, ValueError, LookupError) as error:
        raise WorldError(f"{name} is no valid XML ({first_line(error)}): export it again.") from None
    return root


class YamlLimitError(ValueError):
    """A YAML text that is nested too deeply, or too large."""


class _PlainLoader(yaml.SafeLoader):
    """Plain data alone, as YAML 1.1 has it; aliases may not make it very large."""

    def fetch_flow_collection_start(self, token: Any) -> None:
        # The time for each bracket grows with the open ones.
        if self.flow_level > _DEEPEST_YAML:
            raise YamlLimitError(f"it is nested more than {_DEEPEST_YAML} deep")
        super().fetch_flow_collection_start(token)

    def get_single_data(self) -> Any:
        node = self.get_single_node()
        if node is None:
            return None
        # Before it is constructed: merged mappings are copied then.
        if _count_nodes(node, {}) > _MOST_YAML_VALUES:
            raise YamlLimitError(f"it has more than {_MOST_YAML_VALUES:,} values")
        return self.construct_document(node)

    def construct_yaml_int(self, node: Any) -> int:
        number = int(super().construct_yaml_int(node))
        # Python writes no number of so many digits.
        if number.bit_length() > _MOST_INTEGER_BITS:
            raise ValueError("a whole number has too many digits")
        return number


_PlainLoader.add_constructor("tag:yaml.org,2002:int", _PlainLoader.construct_yaml_int)


def _count_nodes(node: yaml.Node, known: dict[int, float]) -> float:
    """The values in and below `node`, those of an alias at each of its places; infinite for one in itself."""
    if not isinstance(node, yaml.CollectionNode):
        return 1
    if id(node) not in known:
        known[id(node)] = math.inf
        inner = node.value if isinstance(node, yaml.SequenceNode) else itertools.chain(*node.value)
        known[id(node)] = 1 + sum(_count_nodes(each, known) for each in inner)
    return known[id(node)]


def parse_yaml(text: str | bytes) -> Any:
    """The plain data of a YAML text; `ValueError` if it is none, `YamlLimitError` if it is too much."""
    try:
        return yaml.load(text, _PlainLoader)
    except RecursionError:
        raise YamlLimitError("it is nested too deeply") from None
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from None
    # Of its dates and numbers, such as a 30th of February or one of too many digits.
    except (LookupError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(first_line(error)) from None


def read_image(data: bytes) -> Bytes:
    """RGB (rows, columns, 3) of an image, downscaled if large; `ValueError` if it is none."""
    return downscale_image(open_image(data))


def open_image(data: bytes) -> Image.Image:
    """An image of limited size, not yet decoded; `ValueError` if it is none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = Image.open(io.BytesIO(data))
    except Exception as error:
        raise ValueError(f"it is no picture that can be read ({first_line(error)})") from None
    _check_size(image)
    return image


def _check_size(image: Image.Image) -> None:
    if not image.width * image.height:
        raise ValueError("it has no pixels")
    if image.width * image.height > _MAX_PIXELS:
        raise ValueError(f"it has {image.width} by {image.height} pixels, more than {_MAX_PIXELS:,}")


def downscale_image(image: Image.Image) -> Bytes:
    """RGB (rows, columns, 3) of an image, at most 1,024 pixels per side; `ValueError` if it is damaged.

    Transparent pixels get the mean colour of the opaque ones.
    """
    _check_size(image)
    try:
        image.draft("RGB", (_TEXTURE_PIXELS, _TEXTURE_PIXELS))
        has_alpha = "A" in image.getbands() or "transparency" in image.info
        if image.mode.startswith("I;16"):
            # Pillow would clip all but the darkest of 65,536 tones.
            image = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
        image = image.convert("RGBA" if has_alpha else "RGB")
        image.thumbnail((_TEXTURE_PIXELS, _TEXTURE_PIXELS))
        pixels = np.array(image)
        opaque = pixels[..., 3] > 127 if has_alpha else np.zeros(1, bool)
        colours = np.ascontiguousarray(pixels[..., :3])
        if opaque.any():
            colours[~opaque] = colours[opaque].mean(axis=0)
        return colours
    except Exception as error:
        raise ValueError(f"it is no picture that can be read ({first_line(error)})") from None


def load_npy(data: bytes) -> NDArray[Any]:
    """The numbers of an .npy file's bytes; `ValueError` if it has none, or is too short for what it claims.

    Pickles, which are code, are not read.
    """
    file, header = io.BytesIO(data), np.lib.format
    try:
        is_first = header.read_magic(file) == (1, 0)
        read = header.read_array_header_1_0 if is_first else header.read_array_header_2_0
        shape, is_fortran, dtype = read(file)
    # The header is a Python literal, and its parser raises many errors.
    except Exception as error:
        raise ValueError(f"it is no .npy file ({first_line(error)})") from None
    if dtype.kind not in "biuf":
        raise ValueError(f"its values are {dtype}, not numbers")
    # Checked before memory is taken.
    if (
        any(type(side) is not int or side < 0 for side in shape)
        or math.prod(shape) * dtype.itemsize > len(data) - file.tell()
    ):
        raise ValueError(f"it claims numbers of shape {shape}, and is too short for them")
    flat = np.frombuffer(data, dtype, math.prod(shape), file.tell()).copy()
    return flat.reshape(shape[::-1]).T if is_fortran else flat.reshape(shape)


def load_npz(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file by name, as `np.savez` writes it.

    Raises OSError if it cannot be opened, and `ValueError` or `zipfile.BadZipFile` if it is damaged.
    """
    with path.open("rb") as file:
        check_archive(file)
        with zipfile.ZipFile(file) as archive:
            # Reading compares the checksums.
            return {name.removesuffix(".npy"): load_npy(archive.read(name)) for name in archive.namelist()}


def check_archive(file: IO[bytes]) -> None:
    """Refuse an archive whose contents are compressed, or larger than itself: it would fill the memory.

    NumPy and PyTorch write archives of plain contents. Raises `ValueError` or `zipfile.BadZipFile`.
    """
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    packed = any(
        one.compress_type != zipfile.ZIP_STORED or one.file_size > one.compress_size for one in members
    )
    if packed or sum(one.file_size for one in members) > size:
        raise ValueError("its contents are compressed, or larger than the file")


@contextmanager
def reading(name: str, kind: str) -> Iterator[None]:
    """A context in which libraries read a file without warnings; what they raise becomes a `WorldError`."""
    try:
        # Warnings include those of numpy about invalid numbers, which are checked later.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    except WorldError:
        raise
    except Exception as error:
        raise WorldError(
            f"{name} is no {kind} that can be read ({type(error).__name__}: {first_line(error)}): "
            "open it in a program that shows it, and export it again."
        ) from None


def first_line(error: BaseException | str) -> str:
    """The first line of a message, cut to a readable length."""
    text = str(error).strip()
    return printable(text.splitlines()[0]) if text else "no reason given"


def printable(name: str, longest: int = 120) -> str:
    """A text from a file for use in messages: printable, and at most `longest` characters."""
    text = "".join(letter if letter.isprintable() else "?" for letter in name)
    return text if len(text) <= longest else text[: longest - 3] + "..."
