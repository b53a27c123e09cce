"""Subject: what each eye sees, against what it should see, in the world of `lfpipe.bench.world`."""

import itertools
import time
from collections.abc import Iterable, Iterator
from functools import cache, partial

import attrs
import numpy as np

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Column, Figures, Row, Table, Value, mean_of
from lfpipe.bench.runner import Candidate, Offer, Turn
from lfpipe.bench.world.bounds import judged
from lfpipe.bench.world.camera import NOISE_PX, Camera
from lfpipe.bench.world.figures import (
    Errors,
    Pictures,
    evenness,
    picture_figures,
    samples,
    viewpoint_figures,
)
from lfpipe.bench.world.run import Run, Truth, plain_loop, settings, watch
from lfpipe.bench.world.scene import SCENES, WorldScene, scene_of
from lfpipe.bench.world.screen import Screen
from lfpipe.bench.world.scripts import Script, moving, recorded, scripts
from lfpipe.config import Config, Track
from lfpipe.config.quality import METHODS
from lfpipe.render.compositor import Key

PICTURES = (2, 24)  # compared of each script, quick and full
TURN_PICTURES = 8
VIEWPOINTS_PER_SCENE = 8
APART_VIEWS = 1.5  # between the eyes, at most, of the viewpoints of scenes
VIDEOS_HZ = (24.0, 25.0, 30.0, 50.0, 60.0)

VIEWPOINTS = (
    Column("error_views", "error, mean", "views"),
    Column("error_p95", "p95", "views"),
    Column("error_worst", "worst", "views"),
    Column("step_cols", "largest step, sideways", "views"),
    Column("step_rows", "largest step, up and down", "views"),
    Column("step_cols_0", "largest step, sideways, no delay", "views"),
    Column("step_rows_0", "largest step, up and down, no delay", "views"),
    Column("right_s", "until right", "s"),
    Column("depth", "full depth", "% of the time"),
    Column("lag_ms", "lag", "ms"),
    Column("bare_step", "step without a filter", "views"),
    Column("plain_error", "plain loop: error", "views"),
    Column("plain_step", "plain loop: step", "views"),
)
PICTURE_COLUMNS = (
    Column("levels", "error, mean", "levels"),
    Column("levels_p95", "p95", "levels"),
    Column("levels_worst", "worst", "levels"),
    Column("db", "PSNR, mean", "dB"),
    Column("db_p95", "p95", "dB"),
    Column("db_worst", "worst", "dB"),
    Column("seen", "through the glasses, mean", "L*"),
    Column("seen_p95", "p95", "L*"),
    Column("seen_worst", "worst", "L*"),
    Column("seen_db", "mean", "dB"),
    Column("ideal", "ideal viewpoint", "levels"),
    Column("plain", "plain loop", "levels"),
    Column("plain_seen", "plain loop, glasses", "L*"),
    Column("cpu_ms", "thread CPU per picture", "ms"),
)
CONDITION_COLUMNS = (
    *VIEWPOINTS[:5],
    Column("lag_ms", "lag", "ms"),
    Column("late", "pictures that missed their blank", "%"),
    *(Column(f"video_{hz:g}hz", f"video of {hz:g} Hz off plan", "%") for hz in VIDEOS_HZ),
    Column("plain_error", "plain loop: error", "views"),
    Column("plain_lag_ms", "plain loop: lag", "ms"),
)
CAMERAS = {
    "30 Hz": Camera(),
    "10 Hz": Camera(rate_hz=10.0),
    "15 Hz": Camera(rate_hz=15.0),
    "60 Hz": Camera(rate_hz=60.0),
    "120 Hz": Camera(rate_hz=120.0),
    "240 Hz": Camera(rate_hz=240.0),
    "jitter of 4 ms": Camera(jitter_ms=4.0),
    "30 % dropped": Camera(dropped=0.3),
    "10 % doubled": Camera(doubled=0.1),
    "stamps of 5 ms noise": Camera(stamp_noise_ms=5.0),
    "stamps 50 ms early": Camera(stamp_late_ms=-50.0),
    "stamps 50 ms late": Camera(stamp_late_ms=50.0),
    "one stamp in 2 s 200 ms late": Camera(wrong_stamp_ms=200.0),
    "one stamp in 2 s 600 ms early": Camera(wrong_stamp_ms=-600.0),
}
SCREENS = {
    **{f"{hz:g} Hz": Screen(rate_hz=hz) for hz in (60.0, 75.0, 120.0, 144.0)},
    "59.94 Hz": Screen(rate_hz=59.94),
    "143.98 Hz": Screen(rate_hz=143.98),
    "60 Hz, busy machine": Screen(slow=0.02),
    **{f"60 Hz, delay of {ms:g} ms": Screen(loop_ms=ms) for ms in (0.0, 40.0, 120.0)},
}


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Scripts, scenes, cameras and screens; and error against run time."""
    yield from tables(PICTURES[not inputs.quick], recorded(inputs.tracks))
    yield from candidates(inputs.quick)


def tables(count: int, others: Iterable[Script] = ()) -> Iterator[Table]:
    """Everything with bounds. count: of the pictures of each script. others: more scripts."""
    yield from script_tables([*scripts(), *others], count)
    yield from other_tables()


def other_tables() -> Iterator[Table]:
    """What scenes, cameras and screens do."""
    yield scene_table()
    yield condition_table("Cameras", "camera", CAMERAS, {})
    yield condition_table("Screens", "screen", {}, SCREENS)


def script_tables(some: list[Script], count: int) -> Iterator[Table]:
    """What each script does to the viewpoints, and to `count` pictures of it."""
    scene = scene_of(SCENES[0])
    watched = [WatchedScript(scene, script) for script in some]
    note = (
        "Of the demo's scene, camera at 30 Hz, screen at 60 Hz,"
        f" {Screen().loop_ms:g} ms from exposure to light."
    )
    steps = (
        " Step: the largest change from one refresh to the next that the true motion around it"
        " does not explain. Until right: from an event until within 0.25 views. Lag: of a head in"
        " motion."
    )
    rows = [judged(Row(one.script.name, _values(one.viewpoints()))) for one in watched]
    yield Table("script", VIEWPOINTS, tuple(rows), "Viewpoints by script", note + steps)
    pictures = _pictures_of_scripts()
    rows = [judged(Row(one.script.name, _values(one.pictures(pictures, count)))) for one in watched]
    against = (
        " Against the exact picture for the true eyes, of both eyes, before the anaglyph; and L* of"
        " the picture shown through each glass against the published matrix of the exact pictures."
        " The plain loop: mean of 5 frames, a picture per frame, nearest views."
    )
    yield Table("script", PICTURE_COLUMNS, tuple(rows), "Pictures by script", note + against)


@cache
def _pictures_of_scripts() -> Pictures:
    scene = scene_of(SCENES[0])
    return Pictures.of(scene, settings(scene, Screen(), Track()))


class WatchedScript:
    """A script through the product, without a filter, and through the plain loop."""

    def __init__(self, scene: WorldScene, script: Script) -> None:
        self.script = script
        self._scene = scene
        self._screen = Screen()
        self._config = settings(scene, self._screen, Track())
        self._truth = Truth(scene, script, self._config)
        self._run = watch(scene, script, Camera(), self._screen, self._config)
        self._plain = plain_loop(scene, script, Camera(), self._screen, self._config)

    def viewpoints(self) -> Figures:
        """Of the columns VIEWPOINTS."""
        figures = self._figures(self._run)
        screen = Screen(loop_ms=0.0)
        config = settings(self._scene, screen, Track())
        now = self._figures(watch(self._scene, self.script, Camera(), screen, config))
        bare = Track(filter="mean", mean_k=1)
        config = settings(self._scene, self._screen, bare)
        without = self._figures(watch(self._scene, self.script, Camera(), self._screen, config))
        plain = self._figures(self._plain)
        return figures | {
            "step_cols_0": now["step_cols"],
            "step_rows_0": now["step_rows"],
            "bare_step": without["step_cols"],
            "plain_error": plain["error_views"],
            "plain_step": plain["step_cols"],
        }

    def _figures(self, run: Run) -> Figures:
        return viewpoint_figures(run, self._truth, self.script)

    def pictures(self, pictures: Pictures, count: int) -> Figures:
        """Of the columns PICTURE_COLUMNS."""
        run = self._run
        at = samples(run, self.script, count)
        right = self._truth.at(run.ms[at])
        product = pictures.errors([run.keys[k] for k in at], right)
        ideal = pictures.errors([pictures.key(views) for views in right], right)
        nearest = Pictures.of(self._scene, settings(self._scene, self._screen, Track(), "nearest"))
        keys = [self._plain.key_at(ms) for ms in run.ms[at].tolist()]
        plain = nearest.errors(keys, right)
        return picture_figures(product) | {
            "ideal": float(ideal.levels.mean()),
            "plain": float(plain.levels.mean()),
            "plain_seen": float(plain.seen.mean()),
            "cpu_ms": product.cpu_ms + float(np.median(run.cpu_ms)),
        }


def scene_table() -> Table:
    """How every method draws every scene from the right viewpoint."""
    rows = []
    for name, method in itertools.product(SCENES, METHODS):
        scene = scene_of(name)
        pictures = Pictures.of(scene, settings(scene, Screen(), Track(), method))
        right = np.random.default_rng(1).uniform(0, 1, (VIEWPOINTS_PER_SCENE, 3))
        right *= (scene.rows - 1, scene.cols - 1 - APART_VIEWS, APART_VIEWS)
        views = np.stack([right[:, :2], right[:, :2] + right[:, 2:] * (0, 1)], axis=1)
        errors = pictures.errors([pictures.key(pair) for pair in views], views)
        rows.append(judged(Row(f"{name}, {method}", _values(picture_figures(errors)))))
    note = f"{VIEWPOINTS_PER_SCENE} random viewpoints per scene, up to {APART_VIEWS:g} views apart."
    return Table("scene, method", PICTURE_COLUMNS, tuple(rows), "Pictures by scene", note)


def condition_table(
    title: str, of: str, cameras: dict[str, Camera], screens: dict[str, Screen]
) -> Table:
    """What cameras, or screens, do to a moving viewer's viewpoints."""
    scene = scene_of(SCENES[0])
    script = moving()
    rows = []
    usual = Camera(), Screen()
    conditions = {name: (camera, usual[1]) for name, camera in cameras.items()}
    conditions |= {name: (usual[0], screen) for name, screen in screens.items()}
    for name, (camera, screen) in conditions.items():
        config = settings(scene, screen, Track())
        run = watch(scene, script, camera, screen, config)
        truth = Truth(scene, script, config)
        figures = viewpoint_figures(run, truth, script)
        figures["late"] = 100 * run.late
        if screens:
            for hz in VIDEOS_HZ:
                figures[f"video_{hz:g}hz"] = 100 * evenness(run, screen, hz)
            loop = viewpoint_figures(
                plain_loop(scene, script, camera, screen, config), truth, script
            )
            figures |= {"plain_error": loop["error_views"], "plain_lag_ms": loop["lag_ms"]}
        rows.append(judged(Row(name, _values(figures)), of))
    note = "A viewer who sways at 0.7 Hz and takes steps of 200 px/s."
    return Table(of, CONDITION_COLUMNS, tuple(rows), title, note)


def candidates(quick: bool) -> Iterator[Candidate]:
    """Methods, filters and noises of landmarks, on the scripts that move."""
    used = Track().filter
    best = METHODS[0]
    for method in reversed(METHODS):
        in_use = method == best
        yield _candidate(used, method, Variant(method=method), quick, in_use)
    for name in ("mean", "one-euro", "kalman"):
        track = Track(filter=name)
        yield _candidate(name, best, Variant(track=track, method=best), quick)
    for noise_px in (0.15, 2 * NOISE_PX):
        camera = Camera(noise_px=noise_px)
        knob = f"landmarks of {noise_px:g} px"
        yield _candidate(used, knob, Variant(camera=camera), quick)
    yield _candidate("plain loop", "nearest", Variant(track=None, method="nearest"), quick)
    yield _candidate("ideal viewpoint", "", Variant(ideal=True), quick)


@attrs.frozen(kw_only=True)
class Variant:
    """A way to make pictures."""

    track: Track | None = attrs.Factory(Track)
    """None: the plain loop."""
    method: str = "auto"
    camera: Camera = attrs.Factory(Camera)
    ideal: bool = False


def _candidate(
    curve: str, knob: str, variant: Variant, quick: bool, used: bool = False
) -> Candidate:
    prepare = partial(_prepare, variant, PICTURES[not quick])
    return Candidate(
        curve=curve, knob=knob, prepare=prepare, paper=variant.track is None, used=used
    )


@cache
def _moving_scripts() -> tuple[Script, ...]:
    return tuple(script for script in scripts() if script.name in MOVING)


MOVING = ("sways at 0.5 Hz", "sways at 1 Hz", "sways at 2 Hz", "steps", "shakes", "leans in")


def _prepare(variant: Variant, count: int) -> tuple[dict[str, float | Value], Turn]:
    scene = scene_of(SCENES[0])
    screen = Screen()
    config = settings(scene, screen, variant.track or Track(), variant.method)
    pictures = Pictures.of(scene, config)
    errors: list[Errors] = []
    off: list[float] = []
    keys: list[Key] = []
    choices: list[float] = []
    for script in _moving_scripts():
        truth = Truth(scene, script, config)
        run = _watched(variant, scene, script, screen, config)
        at = samples(run, script, count)
        right = truth.at(run.ms[at])
        keys += [pictures.key(views) for views in right] if variant.ideal else run.keys_at(at)
        errors.append(pictures.errors(keys[-len(at) :], right))
        error = 0.0
        if not variant.ideal:
            error = viewpoint_figures(run, truth, script)["error_views"]
            choices += run.cpu_ms.tolist()
        off.append(error)
    figures: dict[str, float | Value] = {
        "error_levels": mean_of([float(one.levels.mean()) for one in errors]),
        "error_seen": mean_of([float(one.seen.mean()) for one in errors]),
        "error_views": mean_of(off),
    }
    upcoming = itertools.cycle(keys)
    choosing_ms = float(np.median(choices)) if choices else 0.0

    def turn() -> Figures:
        started_ns = time.thread_time_ns()
        for _ in range(TURN_PICTURES):
            pictures.draw(next(upcoming))
        spent_ms = (time.thread_time_ns() - started_ns) / 1e6
        return {"picture_ms": choosing_ms + spent_ms / TURN_PICTURES}

    return figures, turn


def _watched(
    variant: Variant, scene: WorldScene, script: Script, screen: Screen, config: Config
) -> Run:
    make = plain_loop if variant.track is None else watch
    return make(scene, script, variant.camera, screen, config)


def _values(figures: Figures) -> dict[str, Value]:
    return {key: Value(value) for key, value in figures.items()}
