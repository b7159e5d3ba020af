"""Policies in ONNX files, which act by ONNX's own runtime."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import ConfigError
from dune_rl.learning.networks.policy import MEMORY
from dune_rl.learning.onnx_file import MEMORY_AFTER, METADATA


def open_session(model: str | bytes) -> Any:
    """The `onnxruntime.InferenceSession` of a file or of its content, on one thread.

    Raises ImportError without onnxruntime, and ValueError, with a line of its reason, where it refuses the
    model.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    # As everywhere in evaluations: equal results on any number of cores.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise ValueError(str(error).partition("\n")[0]) from None


class OnnxPolicy:
    """A policy of an ONNX file, of this package or of others, on one thread.

    A recurrent one keeps a memory for each row from call to call. `description` is what this package wrote
    into the file about it, and empty for files of others. Raises ConfigError where the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise ConfigError(f"policy={path}: there is no such file")
        try:
            session = open_session(str(path))
        except ImportError:
            raise ConfigError(f"policy={path} needs onnxruntime: pip install 'dune_rl[onnx]'") from None
        except ValueError as error:
            raise ConfigError(f"policy={path} cannot be read as an ONNX file: {error}") from None
        self._path, self._session = path, session
        shapes = {each.name: each.shape for each in session.get_inputs()}
        memory = shapes.pop(MEMORY, (0,))
        if not memory or not isinstance(memory[-1], int):
            raise ConfigError(f"policy={path}: its input {MEMORY} has no size; give it one")
        self._memory_units = memory[-1]
        self._shapes = shapes
        # Exporters fix the batch at one unless told otherwise.
        self._one_by_one = any(shape[:1] == [1] for shape in shapes.values())
        self._outputs = [session.get_outputs()[0].name, *([MEMORY_AFTER] if self._memory_units else [])]
        self._memory = np.zeros((0, 1, self._memory_units), np.float32)

    @property
    def is_recurrent(self) -> bool:
        return self._memory_units > 0

    @property
    def description(self) -> dict[str, Any]:
        """What `dune_rl.export` wrote about the policy; empty where it wrote nothing."""
        text = self._session.get_modelmeta().custom_metadata_map.get(METADATA, "")
        try:
            found = json.loads(text or "{}")
        except ValueError:
            found = {}
        return found if isinstance(found, dict) else {}

    @property
    def action_bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """The lowest and the highest actions, (A,) each, in physical units; None where the file says none."""
        try:
            actions = self.description["action"]
            return tuple(float(each["low"]) for each in actions), tuple(
                float(each["high"]) for each in actions
            )
        except (KeyError, TypeError, ValueError):
            return None

    def act(
        self, observation: Mapping[str, NDArray[Any]], begins: NDArray[np.bool_] | None = None
    ) -> NDArray[np.floating]:
        """Actions (N, A) for readings (N, ...); a memory is emptied where an episode `begins` (N,).

        Raises ConfigError where the readings do not fit.
        """
        if self._shapes.keys() <= observation.keys():
            given = {name: observation[name] for name in self._shapes}
        elif len(self._shapes) == 1:
            # As flat observations of the Gymnasium environment: readings in the order of their names.
            rows = [observation[key].reshape(len(observation[key]), -1) for key in sorted(observation)]
            given = {next(iter(self._shapes)): np.concatenate(rows, axis=1).astype(np.float32)}
        else:
            missing = sorted(self._shapes.keys() - observation.keys())
            raise ConfigError(
                f"policy={self._path}: there is no sensor {', '.join(missing)}; there are "
                f"{', '.join(observation)}"
            )
        self._check_shapes(given)
        count = len(next(iter(given.values())))
        if self.is_recurrent:
            given[MEMORY] = self._memory_before(count, begins)
        try:
            if self._one_by_one:
                each = [
                    self._session.run(
                        self._outputs, {name: value[row : row + 1] for name, value in given.items()}
                    )
                    for row in range(count)
                ]
                found = [np.concatenate(parts) for parts in zip(*each, strict=True)]
            else:
                found = self._session.run(self._outputs, given)
        except Exception as error:
            reason = " ".join(str(error).split())
            raise ConfigError(f"policy={self._path} does not fit the observations: {reason}") from None
        if self.is_recurrent:
            self._memory = found[1]
        actions: NDArray[np.floating] = found[0]
        return actions

    def _check_shapes(self, given: Mapping[str, NDArray[Any]]) -> None:
        for name, value in given.items():
            # Of some files the shape is not known, or a size is a name: any fits.
            wanted, found = self._shapes[name][1:] or value.shape[1:], value.shape[1:]
            sizes = zip(wanted, found, strict=False)
            if len(wanted) != len(found) or any(isinstance(a, int) and a != b for a, b in sizes):
                reads, gets = (" x ".join(map(str, each)) or "1" for each in (wanted, found))
                raise ConfigError(
                    f"policy={self._path} reads {name} of size {reads}, and gets {gets}; set the sensors as "
                    "they were in its training"
                )

    def _memory_before(self, count: int, begins: NDArray[np.bool_] | None) -> NDArray[np.float32]:
        if len(self._memory) != count:
            return np.zeros((count, 1, self._memory_units), np.float32)
        if begins is None:
            return self._memory
        return np.where(begins[:, None, None], np.float32(0.0), self._memory)
