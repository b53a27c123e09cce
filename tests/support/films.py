"""Films for tests."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
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
