"""Metrics of a run against ground truth, and their bounds in `lfpipe bench viewer --check`.

Some are of the light that reaches an eye through glasses. The matrices of GLASS turn linear RGB of
an ordinary LCD into the XYZ behind each filter. They integrate spectra of display and filters
(digitised in the public project angler.js, after Woods' measurements) over the CIE 1931 observer.
The display's white is D65 with Y = 1.
"""

import csv
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.results import Metrics, Results, Row, Value, rms, short
from lfpipe.bench.simulator.run import Run, Screen, Setup, Truth
from lfpipe.bench.simulator.scripts import Script
from lfpipe.config import Render
from lfpipe.render.synthesis.anaglyph import MATRICES, decoded
from lfpipe.render.synthesis.compositor import Compositor, Key
from lfpipe.render.viewer.viewer import VIDEO_LEAD, video_frame
from lfpipe.scene.demo_drawing import Picture
from lfpipe.transport.ring import MS_NS

RIGHT_VIEWS = 0.25  # a picture closer than this to the right viewpoint is right
RIGHT_MS = 200.0  # if it stays right for this time
NEAR_MS = 100.0  # true motion within this time of a step explains it: a picture may be late
DEPTH = 0.9  # share of the right eye distance from which on depth is full
EVERY = 2  # pixels: spacing of the comparison through the glasses
Float = NDArray[np.float64]
DECODED = decoded(np.arange(256) / 255.0)  # linear light of code values

# XYZ of a screen's red, green and blue at full intensity, through each filter
GLASS = {
    "red": np.array([(0.1909, 0.0259, 0.0001), (0.0922, 0.0135, 0.0001), (0.0, 0.0, 0.0)]),
    "cyan": np.array([(0.0010, 0.0778, 0.1070), (0.0009, 0.2381, 0.0658), (0.0, 0.0744, 0.5735)]),
    "green": np.array([(0.0006, 0.0429, 0.0044), (0.0006, 0.1266, 0.0170), (0.0, 0.0052, 0.0026)]),
    "magenta": np.array(
        [(0.2437, 0.0309, 0.0512), (0.1174, 0.0153, 0.0043), (0.0, 0.0044, 0.2621)]
    ),
}
RED_CYAN = ("red", "cyan")


def curve(ratio: Float) -> Float:
    """The cube root of CIELAB, with its linear start."""
    return np.where(
        ratio > (6 / 29) ** 3, np.cbrt(np.maximum(ratio, 0.0)), ratio * (29 / 6) ** 2 / 3 + 4 / 29
    )


def lightness(luminance: Float, white: float) -> Float:
    """CIE L*, 0..100 for luminance up to white."""
    return np.asarray(116 * curve(luminance / white) - 16)


def viewpoint_metrics(run: Run, truth: Truth, script: Script) -> Metrics:
    """error_views (mean over the windows; p95, worst), step_cols and step_rows (largest step
    without true motion), right_s (longest time from an event until the picture is right),
    depth (share of time with full depth), lag_ms.
    """
    errors = []
    depths = []
    late_s = []
    power = 0.0
    behind = 0.0
    for window in script.windows:
        inside = window.holds(run.ms)
        ms = run.ms[inside]
        right = truth.views(ms, window)
        shown = run.views[inside]
        off = np.linalg.norm(shown - right, axis=2).max(axis=1)
        errors.append(off)
        depths.append(_eye_distance(shown) >= DEPTH * _eye_distance(right))
        if window.event:
            late_s.append(_time_until_right(off, ms, window.from_s * 1e3))
        velocity = np.gradient(right[..., 1].mean(axis=1), ms)
        power += float(np.square(velocity).sum())
        behind += float(((right - shown)[..., 1].mean(axis=1) * velocity).sum())
    every = np.concatenate(errors)
    steps = np.abs(np.diff(run.views, axis=0)).max(axis=1)  # (n - 1, 2)
    # the depth that appears with the first face is an intended step
    first = int(((run.ms >= script.steps_from_s * 1e3) & (_eye_distance(run.views) > 0)).argmax())
    beyond = (steps - _near(truth.motion(run.ms), run.ms))[first:].max(axis=0, initial=0.0)
    metrics = {
        "error_views": float(every.mean()),
        "error_p95": float(np.percentile(every, 95)),
        "error_worst": float(every.max()),
        "step_cols": float(beyond[1]),
        "step_rows": float(beyond[0]),
        "depth": float(np.concatenate(depths).mean()) * 100,
    }
    if late_s:
        metrics["right_s"] = max(late_s)
    if power > 1e-9:
        metrics["lag_ms"] = behind / power
    return metrics


def _eye_distance(views: Float) -> Float:
    """Eye distance (n,) in views, of viewpoints (n, 2, 2)."""
    return np.asarray(views[:, 1, 1] - views[:, 0, 1])


def _near(motion: Float, ms: Float) -> Float:
    """The largest true motion within NEAR_MS of each time."""
    reach = max(round(NEAR_MS / float(np.median(np.diff(ms)))), 1)
    padded = np.pad(motion, ((reach, reach), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
    return np.asarray(windows.max(axis=-1), np.float64)


def _time_until_right(off: Float, ms: Float, event_ms: float) -> float:
    """Seconds from the event until errors `off` stay right for RIGHT_MS, or to the end."""
    count = max(round(RIGHT_MS / float(np.median(np.diff(ms)))), 1)
    right = np.convolve(off <= RIGHT_VIEWS, np.ones(count), mode="valid") > count - 0.5
    first = int(right.argmax()) if right.any() else len(ms) - 1
    return float(ms[first] - event_ms) / 1e3


def samples(run: Run, script: Script, count: int) -> list[int]:
    """The refreshes whose pictures are compared: the middles of equal parts of the windows."""
    refreshes = np.flatnonzero(np.any([window.holds(run.ms) for window in script.windows], axis=0))
    places = (np.arange(count) + 0.5) * len(refreshes) / count
    return [int(refreshes[place]) for place in np.unique(places.astype(int))]


@attrs.frozen(eq=False)
class Errors:
    """RMS errors (n, 2) of pictures for the left and the right eye."""

    levels: Float
    """In levels, before the anaglyph."""
    seen: Float
    """In L*, through the glasses."""
    cpu_ms: float
    """Median thread CPU time of drawing one picture."""


class Pictures:
    """Draws pictures of a scene as the product does, and compares them with the exact ones."""

    def __init__(self, setup: Setup) -> None:
        self._scene = setup.scene
        render = setup.config.render
        self._compositor = Compositor(self._scene.field, render)
        # one view per eye, in its own colours
        whole = attrs.evolve(render, anaglyph="row-interleaved")
        self._pairs = Compositor(self._scene.field, whole)

    def key(self, views: Float) -> Key:
        """The key of a picture for viewpoints (2, 2)."""
        left, right = views.tolist()
        return self._compositor.key((left[0], left[1]), (right[0], right[1]))

    def draw(self, key: Key) -> Picture:
        return self._compositor.draw(key)

    def errors(self, keys: Sequence[Key], right: Float) -> Errors:
        """Errors of the pictures of keys against those for the right viewpoints (n, 2, 2)."""
        levels = []
        seen = []
        spent_ms = []
        for key, views in zip(keys, right.tolist(), strict=True):
            exact = [self._scene.picture((row, col)) for row, col in views]
            self._pairs.draw(key)
            assert self._pairs.pair is not None
            levels.append([_rms(a, b) for a, b in zip(self._pairs.pair, exact, strict=True)])
            started_ns = time.thread_time_ns()
            drawn = self._compositor.draw(key)
            spent_ms.append((time.thread_time_ns() - started_ns) / 1e6)
            ideal = ideal_light([view[::EVERY, ::EVERY] for view in exact])
            shown = DECODED[drawn[::EVERY, ::EVERY, ::-1]]
            seen.append(
                [_rms(_lightness_of(shown, eye), _lightness_of(ideal, eye)) for eye in (0, 1)]
            )
        return Errors(np.array(levels), np.array(seen), float(np.median(spent_ms)))


def picture_metrics(errors: Errors) -> Metrics:
    """Mean, p95 and worst, in levels, L* and dB."""
    metrics: Metrics = {}
    for name, db_name, values, peak in (
        ("levels", "db", errors.levels, 255.0),
        ("seen", "seen_db", errors.seen, 100.0),
    ):
        db = 20 * np.log10(peak / np.maximum(values, 1e-3))
        metrics |= {
            name: float(values.mean()),
            f"{name}_p95": float(np.percentile(values, 95)),
            f"{name}_worst": float(values.max()),
            db_name: float(db.mean()),
            f"{db_name}_p95": float(np.percentile(db, 5)),
            f"{db_name}_worst": float(db.min()),
        }
    return metrics


def ideal_light(views: Sequence[Picture]) -> Float:
    """The light, RGB 0 to 1, of the anaglyph of two views, uint8 (h, w, 3) BGR, by the published
    matrix in linear light.
    """
    matrix = np.array(MATRICES[Render().anaglyph])
    left, right = (DECODED[view[..., ::-1]] @ matrix[:, k].T for k, view in enumerate(views))
    return np.asarray(np.clip(left + right, 0, 1), np.float64)


def _lightness_of(light: Float, eye: int) -> Float:
    """L*, 0 to 100, of light through an eye's glass, for an eye that is adapted to its white."""
    row = GLASS[RED_CYAN[eye]][1]
    return lightness(light @ row, row.sum())


def _rms(a: NDArray[Any], b: NDArray[Any]) -> float:
    return rms(a.astype(np.float32) - b)


def evenness(run: Run, screen: Screen, video_hz: float) -> float:
    """Share of vblanks at which a video of this rate shows another frame than the one due."""
    settled = len(run.ms) // 2
    targets_ns = run.targets_ns[settled:]
    vblanks_ns = targets_ns[0] + np.rint((run.ms[settled:] - run.ms[settled]) * MS_NS).astype(int)
    start_ns = targets_ns[0] - round(VIDEO_LEAD * screen.period_ns)
    pairs = zip(targets_ns, vblanks_ns.tolist(), strict=True)
    off_plan = [
        video_frame(target_ns, start_ns, video_hz) != video_frame(vblank_ns, start_ns, video_hz)
        for target_ns, vblank_ns in pairs
    ]
    return float(np.mean(off_plan))


LEAST = ("depth",)


BOUNDS: dict[str, dict[str, float]] = {
    row.pop("row"): {metric: float(text) for metric, text in row.items() if text}
    for row in csv.DictReader(Path(__file__).with_name("bounds.csv").read_text().splitlines())
}
"""By script, scene, camera and screen: the largest right value of each figure; for LEAST, the
smallest.
"""


def judged(row: Row, of: str = "") -> Row:
    """The row with its metrics compared with their bounds. of: the kind of the row; "": script."""
    bounds = BOUNDS.get(f"{of} {row.name}" if of else row.name, {})
    values = {
        key: _judged(value, bounds[key], key in LEAST) if key in bounds else value
        for key, value in row.values.items()
    }
    return attrs.evolve(row, values=values)


def _judged(value: Value, bound: float, least: bool) -> Value:
    if value.value >= bound if least else value.value <= bound:
        return attrs.evolve(value, state="ok")
    limit = "at least" if least else "at most"
    return attrs.evolve(
        value, state="failed", words=f"{short(value.value)}, {limit} {short(bound)} is right"
    )


def beyond(results: Results) -> list[str]:
    """A line for each metric beyond its bound, with script, metric and bound."""
    return [
        f"{row.name}: {column}: {value.text}"
        for _, row, column, value in results.judged()
        if value.state != "ok"
    ]
