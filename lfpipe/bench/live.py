"""Benchmark: live light fields. A moving scene is drawn exactly; each estimator sees two of its
views, frame by frame, and draws those of both eyes. A program that draws a scene knows its
disparity, and may draw the views of both eyes alone, for where they are predicted to be.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import NOISE_DN, RATE_HZ, Inputs
from lfpipe.bench.results import Value, mean_of
from lfpipe.bench.runner import Offer, Prepared, Variant, cpu_ms
from lfpipe.bench.synthesis import scaled_up
from lfpipe.config import LiveSource
from lfpipe.config.quality import SIZES
from lfpipe.live.estimator import Estimator, Found
from lfpipe.live.field import LiveViews
from lfpipe.live.records import Pair, disparity_dtype, views_of
from lfpipe.render.synthesis.compositor import ViewRenderer
from lfpipe.render.synthesis.scoring import psnr_db
from lfpipe.scene.demo import SIZE_PX
from lfpipe.scene.demo_drawing import draw_view
from lfpipe.scene.demo_scenes import moving_solids
from lfpipe.scene.disparity import estimate_disparity, quantised, scale_for

FRAMES = (12, 60)  # quick and full
SETTLED = 4  # frames after which an estimator has followed a still scene
VIEWS = (-1.0, 1.0)  # columns of the two views, of the demo's grid
EYES = (0.3, 0.75)  # columns of the eyes, from the left view to the right one
PAIR: list[Pair] = [((0, 0), (0, 1))]
MOVED_VIEWS = 0.1  # of the eyes since a program drew their views: 30 cm/s for 50 ms
PROGRAM_GRID, PROGRAM_EYES = "a program's views and disparity", "a program's views of both eyes"

Frame = NDArray[np.uint8]
Record = Callable[[Frame, int], NDArray[np.void]]  # disparity of a frame; its number


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Every estimator and size of views."""
    count = FRAMES[0 if inputs.quick else 1]
    for (name, method), size in itertools.product(ESTIMATORS, SIZES):
        width = round(SIZE_PX * size)
        yield Variant(
            curve=name,
            parameter=f"views of {width} px",
            prepare=partial(_prepare, name, method, width, count),
            paper=method == "nearest" and size == 1,
            used=name == "fine flow" and size == 1,
        )


@cache
def _view(number: int, u: float) -> Frame:
    """The exact view at a column of a frame, uint8 (height, width, 3) BGR."""
    return np.ascontiguousarray(draw_view(moving_solids(number / RATE_HZ), u, 0.0)[0][..., ::-1])


@cache
def _exact_map(number: int, u: float, width: int) -> NDArray[np.float32]:
    """The exact disparity at a column of a frame, px of views of that width per stored view."""
    disparity = draw_view(moving_solids(number / RATE_HZ), u, 0.0)[1]
    size = ((width + 1) // 2, (width + 1) // 2)
    small = cv2.resize(disparity, size, interpolation=cv2.INTER_NEAREST)
    return small * np.float32((VIEWS[1] - VIEWS[0]) * width / SIZE_PX)


def _column(eye: float) -> float:
    """Of the demo's grid, for a column of the two views."""
    return VIEWS[0] + eye * (VIEWS[1] - VIEWS[0])


def _exact(number: int, eye: float) -> NDArray[np.float32]:
    return _view(number, _column(eye)).astype(np.float32)


def _columns(name: str) -> tuple[float, ...]:
    """The columns, of the demo's grid, from which the two views are drawn."""
    return tuple(_column(eye + MOVED_VIEWS) for eye in EYES) if name == PROGRAM_EYES else VIEWS


@cache
def _frame(number: int, width: int, columns: tuple[float, ...] = VIEWS) -> Frame:
    """Both views side by side, each of that width."""
    sides = width, width
    views = (cv2.resize(_view(number, u), sides, interpolation=cv2.INTER_AREA) for u in columns)
    return np.hstack(list(views))


class _Drawing:
    """What a session does with frames: disparity, and the views of both eyes."""

    def __init__(self, name: str, method: str, width: int) -> None:
        self._live = LiveSource(
            source="demo", rows=1, cols=2, tiles_across=2, frame_px=(2 * width, width)
        )
        self._views = LiveViews(self._live, name)
        self._record = _recorders(self._live)[name]
        self._columns = _columns(name)
        self._method = method

    def draw_number(self, number: int) -> list[NDArray[np.float32]]:
        """The pictures of both eyes in a frame."""
        width = self._live.width_px
        return self.draw(_frame(number, width, self._columns), number)

    def draw(self, frame: Frame, number: int) -> list[NDArray[np.float32]]:
        """The pictures of both eyes, float32 (height, width, 3) BGR, as large as the demo."""
        t_ns = round(number * 1e9 / RATE_HZ)
        views = views_of(PAIR)
        field = self._views.show(frame, views, self._record(frame, number), t_ns)
        # each eye has a renderer of its own, as a program may have drawn its view
        renderers = [ViewRenderer(field, self._method, eye=eye) for eye in (0, 1)]
        return [
            np.moveaxis(
                scaled_up(
                    np.moveaxis(renderer.render(0, eye), -1, 0).astype(np.float32),
                    (SIZE_PX, SIZE_PX),
                ),
                0,
                -1,
            )
            for renderer, eye in zip(renderers, EYES, strict=True)
        ]


def _recorders(live: LiveSource) -> dict[str, Record]:
    estimator = Estimator(live, aligns=False)

    def written(found: Found) -> NDArray[np.void]:
        return found.write(np.zeros((), disparity_dtype(live)))

    def none(_frame: Frame, _number: int) -> NDArray[np.void]:
        return written(Found({}, 0.0, (0.0, 0.0)))

    def of(maps: Iterable[NDArray[np.float32]], positions: NDArray[np.float64]) -> NDArray[np.void]:
        both = dict(zip(views_of(PAIR), maps, strict=True))
        low, high = (float(limit(list(both.values()))) for limit in (np.nanmin, np.nanmax))
        step_px = scale_for(low, high)
        steps = {view: quantised(disparity, step_px) for view, disparity in both.items()}
        return written(Found(steps, step_px, (low, high), positions))

    def known(_frame: Frame, number: int, name: str) -> NDArray[np.void]:
        maps = [_exact_map(number, u, live.width_px) for u in _columns(name)]
        positions = [(0.0, eye + MOVED_VIEWS) for eye in EYES] if name == PROGRAM_EYES else np.nan
        return of(maps, np.full((2, 2), positions))

    def flow(frame: Frame, _number: int, coarse: bool) -> NDArray[np.void]:
        return written(estimator.estimate(frame, PAIR, coarse))

    def packer(frame: Frame, _number: int) -> NDArray[np.void]:
        views = np.stack(np.hsplit(frame[..., ::-1], 2)).transpose(0, 3, 1, 2)[None]
        maps = estimate_disparity(np.ascontiguousarray(views))
        assert maps is not None
        return of(maps[0], np.full((2, 2), np.nan))

    return {
        "nearest view": none,
        "cross-fade": none,
        "coarse flow": partial(flow, coarse=True),
        "fine flow": partial(flow, coarse=False),
        "the packer": packer,
        PROGRAM_GRID: partial(known, name=PROGRAM_GRID),
        PROGRAM_EYES: partial(known, name=PROGRAM_EYES),
    }


ESTIMATORS = (
    ("nearest view", "nearest"),
    ("cross-fade", "blend"),
    ("coarse flow", "warp2"),
    ("fine flow", "warp2"),
    ("the packer", "warp2"),
    (PROGRAM_GRID, "warp2"),
    (PROGRAM_EYES, "warp2"),
)


def _prepare(name: str, method: str, width: int, count: int) -> Prepared:
    drawing = _Drawing(name, method, width)
    squares: list[float] = []
    beyond = 0.0
    last: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = []
    for number in range(count):
        drawn = drawing.draw_number(number)
        exact = [_exact(number, eye) for eye in EYES]
        now = list(zip(drawn, exact, strict=True))
        squares += [float(np.mean((a - b) ** 2)) for a, b in now]
        for (a, b), (a_last, b_last) in zip(now, last, strict=False):
            beyond = max(beyond, _rms(a - a_last) - _rms(b - b_last))
        last = now
    metrics = {
        "rmse": mean_of(np.sqrt(squares).tolist(), power=2),
        "psnr_db": mean_of([psnr_db(square) for square in squares]),
        "step": Value(beyond),
        "flicker": Value(_flicker(name, method, width)),
    }
    timed = _Drawing(name, method, width)
    numbers = itertools.cycle(range(count))
    return metrics, lambda: {"cpu_ms": cpu_ms(partial(_draw_next, timed, numbers), count)}


def _draw_next(drawing: _Drawing, numbers: Iterator[int]) -> None:
    drawing.draw_number(next(numbers))


def _flicker(name: str, method: str, width: int) -> float:
    """Variation over time of pictures of a still scene, by that of the camera's pictures."""
    rng = np.random.default_rng(1)
    drawing = _Drawing(name, method, width)
    still = _frame(0, width)
    drawn: list[NDArray[np.float32]] = []
    taken: list[NDArray[np.float32]] = []
    for number in range(SETTLED + 8):
        noise = rng.normal(0, NOISE_DN, still.shape)
        frame = np.clip(still + noise, 0, 255).astype(np.uint8)
        pictures = drawing.draw(frame, number)
        if number >= SETTLED:
            drawn.append(pictures[0])
            view = np.moveaxis(frame[:, :width], -1, 0).astype(np.float32)
            taken.append(np.moveaxis(scaled_up(view, (SIZE_PX, SIZE_PX)), 0, -1))
    return _variation(drawn) / _variation(taken)


def _variation(pictures: Sequence[NDArray[np.float32]]) -> float:
    return float(np.std(np.stack(pictures), axis=0).mean())


def _rms(difference: NDArray[np.float32]) -> float:
    return float(np.sqrt(np.mean(difference**2)))
