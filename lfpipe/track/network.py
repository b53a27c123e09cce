"""Networks of the mediapipe wheel, run in this thread through LiteRT; mediapipe itself is never imported."""

import ctypes
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.host.quiet import quiet_stderr
from lfpipe.track import models


def model_file(relative: str) -> Path:
    """Path of a file of the mediapipe wheel, for example "modules/face_landmark/face_landmark.tflite". Raises UserError if
    absent."""
    path = models.find_model(relative)
    if path is None:
        folder = models.package_folder()
        where = f"not in {folder}" if folder else "mediapipe is not installed"
        where += f", and not in {models.data_folder()}"
        raise UserError(f"track.engine = litert: face network {Path(relative).name} is missing: {where}", models.REMEDY)
    return path


class Network:
    """One .tflite network, single-threaded: one float32 input, float32 outputs identified by their number of values.

    path: the file. input_shape: the required shape. outputs: number of values of each wanted output. input: the network's own
    memory, float32 of input_shape; fill it before each run.
    Raises UserError if the file is unreadable, not a network, or a network of another shape (another version).
    """

    def __init__(self, path: Path, input_shape: tuple[int, ...], outputs: tuple[int, ...]) -> None:
        from ai_edge_litert.interpreter import Interpreter

        try:
            content = path.read_bytes()
            with quiet_stderr():  # the delegate logs
                self._interpreter: Any = Interpreter(model_content=content, num_threads=1)
                self._interpreter.allocate_tensors()
        except (OSError, ValueError, RuntimeError) as error:
            reason = str(error).strip().splitlines()[0] if str(error).strip() else "LiteRT refuses it"
            raise UserError(f"track.engine = litert: {path}: not a usable face network: {reason}", models.remedy(path)) from None
        inputs, details = self._interpreter.get_input_details(), self._interpreter.get_output_details()
        by_size = {int(np.prod(detail["shape"])): int(detail["index"]) for detail in details}
        taken = tuple(int(size) for size in inputs[0]["shape"])
        if taken != input_shape or any(size not in by_size for size in outputs):
            raise UserError(
                f"track.engine = litert: {path}: another version: input {taken}, outputs of {sorted(by_size)} values,"
                f" expected {input_shape} and {sorted(outputs)}",
                models.remedy(path),
            )
        self._interpreter.invoke()  # the first run is slow: do it before the first frame
        self.input = self._memory(int(inputs[0]["index"])).reshape(input_shape)
        self._outputs = [self._memory(by_size[size]) for size in outputs]
        sha256 = hashlib.sha256(content).hexdigest()
        self.name = f"{path.name} ({_version(sha256)}, sha256 {sha256[:8]})"

    def run(self) -> list[NDArray[np.float32]]:
        """The wanted outputs, flat, for the contents of `input`; valid until the next run."""
        self._interpreter.invoke()
        return self._outputs

    def _memory(self, index: int) -> NDArray[np.float32]:
        """A flat view of a tensor's memory. Its address does not change: nothing is allocated after the first run. (LiteRT's
        own views must be dropped before each run, so they cannot be stored.)"""
        tensor = self._interpreter.tensor(index)()
        return np.frombuffer((ctypes.c_float * tensor.size).from_address(tensor.ctypes.data), np.float32)


def _version(sha256: str) -> str:
    """The mediapipe version of a network, by its checksum."""
    return f"mediapipe {models.VERSION}" if sha256 in models.SHA256.values() else "mediapipe of unknown version"
