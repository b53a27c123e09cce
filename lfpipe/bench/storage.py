"""Subject: how views are kept: bytes, time to get one, and error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.anaglyph import view_bgr
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.model import Candidate, Diagram, Figure, Prepared, Skipped, Subject
from lfpipe.bench.timing import times_ms

VIEWS = 5


@attrs.frozen
class Codec:
    curve: str
    knob: str
    extension: str
    parameters: tuple[int, ...]


def codecs() -> list[Codec]:
    png = [Codec("PNG", f"level {k}", ".png", (cv2.IMWRITE_PNG_COMPRESSION, k)) for k in (1, 3, 9)]
    jpeg = [Codec("JPEG", f"quality {q}", ".jpg", (cv2.IMWRITE_JPEG_QUALITY, q)) for q in (75, 90, 95, 100)]
    # above 100 OpenCV's WebP writes without loss
    webp = [Codec("WebP", f"quality {q}", ".webp", (cv2.IMWRITE_WEBP_QUALITY, q)) for q in (75, 90)]
    return [*png, *jpeg, *webp, Codec("WebP lossless", "", ".webp", (cv2.IMWRITE_WEBP_QUALITY, 101))]


def candidates(inputs: Inputs) -> Iterator[Candidate | Skipped]:
    """PNG, JPEG, WebP and the pack as it lies in memory."""
    field = inputs.field
    places = list(zip(*(np.linspace(0, n - 1, VIEWS).round().astype(int) for n in (field.rows, field.cols)), strict=True))
    places = sorted({(int(r), int(c)) for r, c in places})
    views = [view_bgr(field, *place) for place in places]
    for codec in codecs():
        paper = (codec.curve, codec.knob) == ("PNG", "level 3")
        yield Candidate(codec.curve, codec.knob, partial(_coded, views, codec), paper)
    yield Candidate("pack", "three planes", partial(_packed, inputs, places, views, range(field.channels)))
    if field.channels == 3:
        yield Candidate("pack", "one plane", partial(_packed, inputs, places, views, range(1)))


def _coded(views: list[NDArray[np.uint8]], codec: Codec) -> Prepared:
    written: list[NDArray[np.uint8]] = []
    for view in views:
        done, data = cv2.imencode(codec.extension, view, list(codec.parameters))
        if not done:
            raise ValueError(f"this OpenCV writes no {codec.curve}")
        written.append(np.asarray(data, np.uint8))

    def read(k: int) -> NDArray[np.uint8]:
        return np.asarray(cv2.imdecode(written[k], cv2.IMREAD_COLOR), np.uint8)

    def errors() -> dict[str, list[float]]:
        wrong = [float(np.sqrt(np.mean((read(k).astype(np.float32) - view) ** 2))) for k, view in enumerate(views)]
        sizes = [len(data) / (view.shape[0] * view.shape[1]) for data, view in zip(written, views, strict=True)]
        return {"rmse": wrong, "bytes_px": sizes}

    return Prepared(errors, _turn(lambda k: read(k % len(views)), views))


def _packed(inputs: Inputs, places: list[tuple[int, int]], views: list[NDArray[np.uint8]], channels: range) -> Prepared:
    """The pack: views are read from its map, as copies, so that every byte is touched."""
    stored = np.asarray(inputs.field.views)[0]
    out = np.empty((len(channels), *stored.shape[3:]), np.uint8)

    def read(k: int) -> None:
        row, col = places[k % len(places)]
        np.copyto(out, stored[row, col, channels.start : channels.stop])

    def errors() -> dict[str, list[float]]:
        wrong = []
        for k, view in enumerate(views):
            read(k)
            rgb = view[..., ::-1].transpose(2, 0, 1)[: len(out)]
            wrong.append(float(np.sqrt(np.mean((out.astype(np.float32) - rgb) ** 2))))
        return {"rmse": wrong, "bytes_px": [float(len(channels))] * len(views)}

    return Prepared(errors, _turn(read, views))


def _turn(read: Callable[[int], object], views: list[NDArray[np.uint8]]) -> Callable[[], dict[str, float]]:
    at = 0

    def once() -> None:
        nonlocal at
        at += 1
        read(at)

    def turn() -> dict[str, float]:
        times = times_ms(once, len(views))
        return {"time_ms": float(np.median(times)), "time_p95_ms": float(np.percentile(times, 95))}

    return turn


SUBJECT = Subject(
    "storage",
    "Keeping the views",
    "Every format holds the same views: how large, how exact, and how long until a view can be drawn. The pack keeps planes"
    " apart, so that a picture reads only what it shows.",
    (
        Figure("rmse", "error of a view, RMSE", "levels", "rms"),
        Figure("bytes_px", "size", "bytes per pixel", "mean"),
        Figure("time_ms", "time to get a view, p50", "ms"),
        Figure("time_p95_ms", "time to get a view, p95", "ms"),
    ),
    (
        Diagram("storage", "Error of a view against the time to get it", "time_ms", "rmse", "time_p95_ms"),
        Diagram("storage-size", "Size against the time to get a view", "time_ms", "bytes_px", "time_p95_ms"),
    ),
    candidates,
    paper="PNG pictures, as the paper's scenes are distributed",
    budget_s=(3.0, 30.0),
)
