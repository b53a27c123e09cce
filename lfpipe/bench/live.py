"""Benchmark: live light fields. Two cameras that differ see a scene whose views are known; each
method draws views between them, frame by frame.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import NOISE_DN, RATE_HZ, Inputs
from lfpipe.bench.results import Column, Row, Table, Value, mean_of, rms
from lfpipe.bench.runner import Offer, Prepared, Variant, cpu_ms
from lfpipe.config import LiveSource
from lfpipe.live.field import Estimator, LiveViews
from lfpipe.live.records import Pair, views_of
from lfpipe.render.plan import psnr_db
from lfpipe.render.synthesis.compositor import ViewRenderer
from lfpipe.scene.optical_flow import displaced

SCALES, FRAMES = (0.5, 1.0), (12, 48)  # quick and full
FINER = 2  # px of the scene per px of a view
COMPARED = 6  # the last frames
BETWEEN = (0.25, 0.5, 0.75)  # views, from the left camera to the right one
INSIDE = np.s_[32:-32, 32:-32]  # at the border are parts that only one camera sees
PAIR: list[Pair] = [((0, 0), (0, 1))]

Frame = NDArray[np.uint8]
Float = NDArray[np.float32]
# measures what it needs to draw views of a frame, from 0 to 1
Method = Callable[[Frame], Callable[[float], Float]]


@attrs.frozen
class Case:
    """A scene, and by what the right camera differs from the left one."""

    optics: Callable[[NDArray[np.complex128]], NDArray[np.complex128]] = lambda at: at
    """Where a camera like the left one has what the right one has at places x + y i, in halves of
    the width from the middle.
    """
    response: Callable[[Float], NDArray[np.floating[Any]]] = lambda values: values
    simple: bool = False
    """Without bars, wall and highlights."""
    still: bool = False
    baseline: float = 1.0
    delay_ms: float = 0.0
    noise_levels: float = 0.0
    """Of both."""
    scale: float = 1.0

    @property
    def size_px(self) -> tuple[int, int]:
        return round(640 * self.scale), round(480 * self.scale)


CASES = {
    "everything in the scene": Case(),
    "simple: without bars, highlights, wall": Case(simple=True),
    "half the baseline": Case(baseline=0.5),
    "twice the baseline": Case(baseline=2),
    "three times the baseline": Case(baseline=3),
    "nothing moves": Case(still=True),
    "simple, nothing moves": Case(simple=True, still=True),
    "one camera 12 px higher": Case(lambda at: at + 12j / 320),
    "turned by 1.5 degrees": Case(lambda at: at * 1j ** (1.5 / 90)),
    "zoom of 2 %": Case(lambda at: at * 1.02),
    "simple, a quarter darker": Case(response=lambda values: values * 0.75, simple=True),
    "simple, other colours": Case(
        response=lambda values: 255 * (values / 255) ** 1.2 * np.array((0.8, 1, 1.1)),
        simple=True,
    ),
    "simple, lens of k1 = 0.04": Case(lambda at: at * (1 + 0.04 * abs(at) ** 2), simple=True),
    "simple, keystone of 2 %": Case(lambda at: at * (1 + 0.02 * at.real), simple=True),
    "simple, 16 ms later": Case(simple=True, delay_ms=16),
    "simple, noise of 3 levels": Case(simple=True, noise_levels=3),
    "webcams": Case(
        lambda at: at * (1 + 0.02 * abs(at) ** 2) * 1j ** (1 / 90),
        lambda values: values * 0.85,
        delay_ms=12,
        noise_levels=2.5,
    ),
}
QUICK = ("everything in the scene", "simple, a quarter darker", "webcams")


@lru_cache(maxsize=2)
def _planes(finer: float) -> list[tuple[Float, float, float, float, tuple[float, float]]]:
    """Those of the simple scene, and the others; each back to front: picture, float32 (height,
    width, 3) BGR; x, y and disparity in px; the most by which it sways. finer: px per px.
    """
    rng = np.random.default_rng(1)

    def plane(width: int, height: int, contrast: float, *colour: float) -> Float:
        noise = rng.standard_normal((round(height * finer), round(width * finer), 3))
        mixed = sum(
            share * (soft := cv2.GaussianBlur(noise, (0, 0), times * finer)) / soft.std()
            for times, share in ((1.2, 1.0), (5, 0.9), (17, 0.8))
        )
        return np.asarray(np.clip(contrast * mixed + colour, 0, 255), np.float32)

    return [
        (plane(1240, 780, 25, 120, 120, 120), -300, -150, 3, (0, 0)),
        (plane(200, 160, 30, 90, 110, 150), 60, 200, 9, (36, 12)),
        (plane(120, 140, 30, 150, 120, 90), 380, 240, 13, (60, 0)),
        (plane(150, 110, 33, 110, 150, 110), 230, 330, 18, (24, 20)),
        (plane(180, 140, 0, 180, 190, 200), 430, 60, 5, (0, 0)),
        *(
            (plane(4, 170, 0, 40 + 30 * k, 60, 200 - 25 * k), 90 + 40 * k, 40, 12 + k, (0, 0))
            for k in range(6)
        ),
        *((plane(14, 8, 0, 250, 250, 250), 120 + 110 * k, 260, -4, (0, 0)) for k in range(4)),
    ]


def _exact(case: Case, frame: float, u: float) -> Float:
    """The view from u, 0 at the left camera and 1 at the right one, float32 (height, width, 3)
    BGR, at the time of a frame.
    """
    finer = FINER * case.scale
    width, height = case.size_px
    drawn = np.zeros((FINER * height, FINER * width, 3), np.float32)
    t_s = 0.0 if case.still else frame / RATE_HZ
    for picture, x, y, disparity, sway in _planes(finer)[: 4 if case.simple else None]:
        x += sway[0] * math.sin(1.3 * t_s) - disparity * case.baseline * (u - 0.5)
        y += sway[1] * math.sin(1.7 * t_s)
        # of the drawing, only the part that is covered
        left, top = max(math.floor(x * finer), 0), max(math.floor(y * finer), 0)
        tall, wide = picture.shape[:2]
        part = drawn[top : math.ceil(y * finer + tall) + 1, left : math.ceil(x * finer + wide) + 1]
        there = np.array([[1, 0, x * finer - left], [0, 1, y * finer - top]])
        moved, cover = (
            cv2.warpAffine(one, there, part.shape[1::-1], borderMode=border)
            for one, border in (
                (picture, cv2.BORDER_REPLICATE),
                (np.ones_like(picture), cv2.BORDER_CONSTANT),
            )
        )
        part += cover * (moved - part)
    return np.asarray(cv2.resize(drawn, case.size_px, interpolation=cv2.INTER_AREA), np.float32)


@lru_cache(maxsize=3)
def _frames(case: Case, count: int) -> list[Frame]:
    """Frames of both cameras, side by side."""
    width, height = case.size_px
    y, x = (np.mgrid[:height, :width] + 0.5 - np.reshape(case.size_px[::-1], (2, 1, 1)) / 2) * (
        2 / width
    )
    at = (case.optics(x + 1j * y) + complex(1, height / width)) * (width / 2) - (0.5 + 0.5j)
    rng = np.random.default_rng(1)
    frames = []
    for number in range(count):
        view = _exact(case, number + case.delay_ms * RATE_HZ / 1000, 1.0)
        image = cv2.remap(
            *(view, at.real.astype(np.float32), at.imag.astype(np.float32)),
            cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )
        right = case.response(np.clip(image, 0, 255).astype(np.float32))
        both = np.hstack([_exact(case, number, 0.0), right])
        both += rng.normal(0, case.noise_levels, both.shape)
        frames.append(np.clip(np.rint(both), 0, 255).astype(np.uint8))
    return frames


@lru_cache(maxsize=3)
def _wanted(case: Case, count: int) -> Float:
    """The exact views of the last frames: (frames, views, height, width, 3)."""
    numbers = range(count - COMPARED, count)
    return np.array([[_exact(case, k, u)[INSIDE] for u in BETWEEN] for k in numbers])


def _lfpipe(case: Case) -> Method:
    width, height = case.size_px
    live = LiveSource(source="demo", rows=1, cols=2, tiles_across=2, frame_px=(2 * width, height))
    estimator, views = Estimator(live, aligns=True), LiveViews(live, "bench")

    def take(frame: Frame) -> Callable[[float], Float]:
        record = estimator.estimate(frame, PAIR)

        def draw(u: float) -> Float:
            field = views.show(frame, views_of(PAIR), record, 0)
            return ViewRenderer(field, "warp2").render(0, u).astype(np.float32)

        return draw

    return take


def _flow(case: Case, size: float) -> Method:
    """Both views warped by dense inverse search at a size of theirs, and cross-faded."""
    engine = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    width, height = (round(side * size) for side in case.size_px)

    def take(frame: Frame) -> Callable[[float], Float]:
        views = np.split(frame, 2, axis=1)
        a, b = (
            cv2.resize(one, (width, height), interpolation=cv2.INTER_AREA)
            for one in (cv2.cvtColor(view, cv2.COLOR_BGR2GRAY) for view in views)
        )
        zeros = np.zeros((height, width, 2), np.float32)
        flows = engine.calc(a, b, zeros.copy()), engine.calc(b, a, zeros)
        return lambda u: _faded(
            u,
            *(
                displaced(view, np.asarray(cv2.resize(flow, case.size_px) * -share / size))
                for view, flow, share in zip(views, flows, (u, 1 - u), strict=True)
            ),
        )

    return take


def _faded(u: float, left: NDArray[Any], right: NDArray[Any]) -> Float:
    return np.asarray((1 - u) * left + u * right, np.float32)


METHODS: dict[str, Callable[[Case], Method]] = {
    "lfpipe": _lfpipe,
    "DIS": partial(_flow, size=1.0),
    "DIS at half size": partial(_flow, size=0.5),
    "cross-fade": lambda _: lambda frame: lambda u: _faded(u, *np.split(frame, 2, axis=1)),
}


def measure(inputs: Inputs) -> Iterator[Offer]:
    """CPU and steadiness of every method, and the error in every case."""
    at = 0 if inputs.quick else 1
    scale, count = SCALES[at], FRAMES[at]
    for name in METHODS:
        prepare = partial(_prepare, name, Case(scale=scale), count)
        yield Variant(curve=name, parameter="", prepare=prepare, used=name == "lfpipe")
    rows = []
    for title in QUICK if inputs.quick else CASES:
        case = attrs.evolve(CASES[title], scale=scale)
        rows.append(Row(title, {name: _psnr(differences(name, case, count)) for name in METHODS}))
    columns = tuple(Column(name, name, "dB") for name in METHODS)
    yield Table("case", columns, tuple(rows), "PSNR of views at 1/4, 1/2 and 3/4 of the way")


def differences(name: str, case: Case, count: int) -> Float:
    """By what the last views of a method differ."""
    take = METHODS[name](case)
    draws = [take(frame) for frame in _frames(case, count)][-COMPARED:]
    drawn = np.array([[draw(u)[INSIDE] for u in BETWEEN] for draw in draws])
    return np.asarray(drawn - _wanted(case, count), np.float32)


def _psnr(off: Float) -> Value:
    return mean_of([psnr_db(square) for square in np.mean(off**2, axis=(2, 3, 4)).ravel()])


def _prepare(name: str, case: Case, count: int) -> Prepared:
    off = differences(name, case, count)
    metrics = {"rmse": Value(rms(off)), "psnr_db": _psnr(off)}
    for key, still in (("still", True), ("moving", False)):
        noisy = attrs.evolve(case, still=still, noise_levels=NOISE_DN)
        metrics[key] = Value(float(np.std(differences(name, noisy, count), axis=0).mean()))
    take, frames = METHODS[name](case), itertools.cycle(_frames(case, count))
    return metrics, lambda: {"cpu_ms": cpu_ms(lambda: take(next(frames)), count)}
