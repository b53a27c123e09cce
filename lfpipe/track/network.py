"""Networks of the mediapipe wheel, run in this thread through LiteRT; mediapipe itself is never imported (0.6 s)."""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.host.native_stderr import quiet_stderr

_REMEDY = "`pip install --force-reinstall mediapipe==0.10.21`: the last version whose wheel carries the face networks"


def model_file(relative: str) -> Path:
    """Path of a file of the mediapipe wheel, as "modules/face_landmark/face_landmark.tflite". Raises UserError if absent."""
    spec = importlib.util.find_spec("mediapipe")  # of a top-level package: finds, does not import
    folders = [Path(folder) for folder in (spec.submodule_search_locations or [])] if spec else []
    for folder in folders:
        if (folder / relative).is_file():
            return folder / relative
    where = f"not in {folders[0]}" if folders else "mediapipe is not installed"
    raise UserError(f"track.engine = litert: face network {Path(relative).name} is missing: {where}", _REMEDY)


class Network:
    """One .tflite network, single-threaded: one float32 input, float32 outputs told apart by their number of values.

    path: the file. input_shape: what it must take. outputs: how many values each wanted output must have. input: the network's
    own memory, float32 of input_shape, to be filled before each run.
    Raises UserError where the file is unreadable, no network, or a network of another shape (another version).
    """

    def __init__(self, path: Path, input_shape: tuple[int, ...], outputs: tuple[int, ...]) -> None:
        from ai_edge_litert.interpreter import Interpreter

        try:
            content = path.read_bytes()
            with quiet_stderr():  # the delegate announces itself
                self._interpreter: Any = Interpreter(model_content=content, num_threads=1)
                self._interpreter.allocate_tensors()
        except (OSError, ValueError, RuntimeError) as error:
            reason = str(error).strip().splitlines()[0] if str(error).strip() else "LiteRT refuses it"
            raise UserError(f"track.engine = litert: {path}: not a usable face network: {reason}", _REMEDY) from None
        inputs, details = self._interpreter.get_input_details(), self._interpreter.get_output_details()
        by_size = {int(np.prod(detail["shape"])): int(detail["index"]) for detail in details}
        taken = tuple(int(size) for size in inputs[0]["shape"])
        if taken != input_shape or any(size not in by_size for size in outputs):
            raise UserError(
                f"track.engine = litert: {path}: a network of another version: takes {taken} and gives {sorted(by_size)} values,"
                f" wanted {input_shape} and {sorted(outputs)}",
                _REMEDY,
            )
        self._interpreter.invoke()  # the first run sets things up: not on the first frame's time
        self.input = self._memory(int(inputs[0]["index"])).reshape(input_shape)
        self._outputs = [self._memory(by_size[size]) for size in outputs]
        self.name = f"{path.name} ({_version(path)}, sha256 {hashlib.sha256(content).hexdigest()[:8]})"

    def run(self) -> list[NDArray[np.float32]]:
        """The wanted outputs, flat, for what is in `input`; valid until the next run."""
        self._interpreter.invoke()
        return self._outputs

    def _memory(self, index: int) -> NDArray[np.float32]:
        """A tensor where it lies, flat. It stays there: nothing is allocated after the first run. (LiteRT's own views must be
        gone before each run, so they cannot be kept.)"""
        tensor = self._interpreter.tensor(index)()
        return np.frombuffer((ctypes.c_float * tensor.size).from_address(tensor.ctypes.data), np.float32)


def _version(path: Path) -> str:
    """Which mediapipe a model file is of, by its metadata folder's name: importlib.metadata would cost 20 ms of a start."""
    package = next((folder for folder in path.parents if folder.name == "mediapipe"), path)
    found = [folder.name.removesuffix(".dist-info") for folder in package.parent.glob("mediapipe-*.dist-info")]
    return found[0].replace("-", " ") if len(found) == 1 else "mediapipe of unknown version"
