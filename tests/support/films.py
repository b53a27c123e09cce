"""Films for tests."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from fractions import Fraction
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def write_film(
    path: Path,
    frames: Iterable[NDArray[Any]],
    codec: str = "MJPG",
    rate_hz: float = 30.0,
    backend: int = cv2.CAP_ANY,
) -> Path:
    """A video of BGR frames; returns its path."""
    first, *others = frames
    fourcc = cv2.VideoWriter.fourcc(*codec)
    writer = cv2.VideoWriter(str(path), backend, fourcc, rate_hz, first.shape[1::-1])
    for frame in (first, *others):
        writer.write(frame)
    writer.release()
    return path


def write_stamped(
    path: Path, frames: Sequence[NDArray[Any]], stamps_ms: Iterable[int], **metadata: str
) -> Path:
    """An H.264 video of RGB frames with these stamps; returns its path. metadata: of its stream."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "10"})
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        stream.metadata.update(metadata)
        stream.height, stream.width = frames[0].shape[:2]
        for picture, stamp_ms in zip(frames, stamps_ms, strict=True):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame.pts, frame.time_base = int(stamp_ms), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def write_av1(path: Path, frames: NDArray[Any]) -> Path:
    """An AV1 video of RGB frames; returns its path. A process of its own encodes: as root, SVT-AV1
    gives the thread that calls it a real-time policy, which all processes started later inherit.
    """
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as other:
        other.submit(_encode_av1, path, frames).result()
    return path


def _encode_av1(path: Path, frames: NDArray[Any]) -> None:
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libsvtav1", rate=10, options={"preset": "10", "crf": "10"})
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
