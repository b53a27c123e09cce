"""Benchmark: the picture of each eye against the exact one, in the simulator."""

import itertools
from collections.abc import Iterable, Iterator
from functools import cache, partial

import attrs
import numpy as np

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Column, Metrics, Row, Table, Value, range_of, ratio_of
from lfpipe.bench.runner import Offer, Prepared, Variant, cpu_ms
from lfpipe.bench.simulator.camera import NOISE_PX, Camera
from lfpipe.bench.simulator.metrics import (
    Errors,
    Pictures,
    evenness,
    judged,
    picture_metrics,
    samples,
    viewpoint_metrics,
)
from lfpipe.bench.simulator.run import Run, Screen, Setup, Truth
from lfpipe.bench.simulator.scene import SCENES, scene_of
from lfpipe.bench.simulator.scripts import MOVES_ABOUT, SCRIPTS, Script, recorded
from lfpipe.config import FILTER_MODULES, Track
from lfpipe.config.quality import METHODS

PICTURES = (8, 24)  # of each script to compare, quick and full
PHASES = (4, 12)  # of the camera against the screen, quick and full
REPETITION_PICTURES = 8
VIEWPOINTS_PER_SCENE = 8
EYE_DISTANCE_VIEWS = 1.5  # maximum eye distance of the viewpoints of scenes
VIDEOS_HZ = (24.0, 25.0, 30.0, 50.0, 60.0)
# scripts of the variants
MOVING = ("sways at 0.5 Hz", "sways at 1 Hz", "sways at 2 Hz", "steps", "shakes", "leans in")

VIEWPOINTS = (
    Column("error_views", "error, mean", "views"),
    Column("error_p95", "p95", "views"),
    Column("error_worst", "worst", "views"),
    Column("step_cols", "largest step, sideways", "views"),
    Column("step_rows", "largest step, up and down", "views"),
    Column("error_views_0", "error, mean, no delay", "views"),
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
    Column("late", "pictures that missed their vblank", "%"),
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
    "30, 15, 7.5 and 30 Hz": Camera(every=(1, 2, 4, 1)),
    "stamps 1 s early": Camera(stamp_late_ms=-1000.0),
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
    **{f"60 Hz, delay of {ms:g} ms": Screen(device_latency_ms=ms) for ms in (0.0, 40.0, 120.0)},
}


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Yields scripts, scenes, cameras and screens; and error against run time."""
    count = PICTURES[not inputs.quick]
    yield from script_tables([*SCRIPTS, *recorded(inputs.tracks)], count)
    yield from other_tables(PHASES[not inputs.quick])
    yield from variants(count)


def other_tables(phases: int) -> Iterator[Table]:
    """The effects of scenes, cameras and screens."""
    yield scene_table()
    cameras = {name: Setup(camera=camera) for name, camera in CAMERAS.items()}
    screens = {name: Setup(screen=screen) for name, screen in SCREENS.items()}
    yield condition_table("Cameras", "camera", cameras, phases)
    yield condition_table("Screens", "screen", screens, phases)


def plain_loop(screen: Screen | None = None) -> Setup:
    """The paper's method."""
    return Setup(screen=screen or Screen(), track=None, method="nearest")


@cache
def watched(setup: Setup, script: Script) -> Run:
    """The pictures on the screen for a script."""
    return setup.watch(script)


@cache
def pictures_of(setup: Setup) -> Pictures:
    """The pictures that a setup draws."""
    return Pictures(setup)


def viewpoints(setup: Setup, script: Script) -> Metrics:
    """See `viewpoint_metrics`."""
    return viewpoint_metrics(watched(setup, script), Truth(setup, script), script)


def script_tables(some: Iterable[Script], count: int) -> Iterator[Table]:
    """The effects of each script on the viewpoints, and on `count` of its pictures."""
    some = list(some)
    note = (
        "The demo scene, a camera at 30 Hz, a screen at 60 Hz, a device latency of"
        f" {Screen().device_latency_ms:g} ms."
    )
    steps = (
        " Step: the largest change from one refresh to the next that the true motion around it"
        " does not explain. Until right: from an event until the error is below 0.25 views. Lag:"
        " with a head in motion."
    )
    rows = [_row(script.name, script_viewpoints(script)) for script in some]
    yield Table("script", VIEWPOINTS, tuple(rows), "Viewpoints by script", note + steps)
    rows = [_row(script.name, script_pictures(script, count)) for script in some]
    against = (
        " Against the exact picture for the true eyes, of both eyes, before the anaglyph; and L* of"
        " the picture seen through each filter against the published matrix of the exact pictures."
        " The plain loop: mean of 5 frames, a picture per frame, nearest views."
    )
    yield Table("script", PICTURE_COLUMNS, tuple(rows), "Pictures by script", note + against)


def script_viewpoints(script: Script) -> Metrics:
    """The values of the columns VIEWPOINTS."""
    now = viewpoints(Setup(screen=Screen(device_latency_ms=0.0)), script)
    bare = viewpoints(Setup(track=Track(filter="mean", mean_k=1)), script)
    plain = viewpoints(plain_loop(), script)
    return viewpoints(Setup(), script) | {
        "error_views_0": now["error_views"],
        "step_cols_0": now["step_cols"],
        "step_rows_0": now["step_rows"],
        "bare_step": bare["step_cols"],
        "plain_error": plain["error_views"],
        "plain_step": plain["step_cols"],
    }


def script_pictures(script: Script, count: int) -> Metrics:
    """The values of the columns PICTURE_COLUMNS."""
    usual = Setup()
    pictures = pictures_of(usual)
    run = watched(usual, script)
    at = samples(run, script, count)
    right = Truth(usual, script).at(run.ms[at])
    product = pictures.errors([run.keys[k] for k in at], right)
    ideal = pictures.errors([pictures.key(views) for views in right], right)
    loop = watched(plain_loop(), script)
    plain = pictures_of(plain_loop()).errors([loop.key_at(ms) for ms in run.ms[at].tolist()], right)
    return picture_metrics(product) | {
        "ideal": float(ideal.levels.mean()),
        "plain": float(plain.levels.mean()),
        "plain_seen": float(plain.seen.mean()),
        "cpu_ms": product.cpu_ms + float(np.median(run.cpu_ms)),
    }


def scene_table() -> Table:
    """The error of every method for every scene, from the right viewpoint."""
    rows = []
    for name, method in itertools.product(SCENES, METHODS):
        scene = scene_of(name)
        pictures = pictures_of(Setup(scene=scene, method=method))
        right = np.random.default_rng(1).uniform(0, 1, (VIEWPOINTS_PER_SCENE, 3))
        right *= (scene.rows - 1, scene.cols - 1 - EYE_DISTANCE_VIEWS, EYE_DISTANCE_VIEWS)
        views = np.stack([right[:, :2], right[:, :2] + right[:, 2:] * (0, 1)], axis=1)
        errors = pictures.errors([pictures.key(pair) for pair in views], views)
        rows.append(_row(f"{name}, {method}", picture_metrics(errors)))
    note = (
        f"{VIEWPOINTS_PER_SCENE} random viewpoints per scene,"
        f" up to {EYE_DISTANCE_VIEWS:g} views apart."
    )
    return Table("scene, method", PICTURE_COLUMNS, tuple(rows), "Pictures by scene", note)


def condition_table(title: str, of: str, setups: dict[str, Setup], phases: int) -> Table:
    """The effect of cameras or screens on the viewpoints of a moving viewer: the mean and the range
    over phases of the camera against the screen.
    """
    rows = []
    for name, setup in setups.items():
        outcomes = [
            condition(
                attrs.evolve(setup, camera=attrs.evolve(setup.camera, phase=k / phases)),
                of == "screen",
            )
            for k in range(phases)
        ]
        values = {key: range_of([one[key] for one in outcomes]) for key in outcomes[0]}
        rows.append(judged(Row(name, values), of))
    note = (
        "A viewer who sways at 0.7 Hz and takes steps of 200 px/s: the mean and the range over"
        f" {phases} phases of the camera against the screen."
    )
    return Table(of, CONDITION_COLUMNS, tuple(rows), title, note)


def condition(setup: Setup, video: bool) -> Metrics:
    """The values of the columns CONDITION_COLUMNS. video: include those of videos and the plain
    loop.
    """
    run = watched(setup, MOVES_ABOUT)
    metrics = viewpoints(setup, MOVES_ABOUT) | {"late": 100 * run.late}
    if video:
        for hz in VIDEOS_HZ:
            metrics[f"video_{hz:g}hz"] = 100 * evenness(run, setup.screen, hz)
        loop = viewpoints(attrs.evolve(setup, track=None, method="nearest"), MOVES_ABOUT)
        metrics |= {"plain_error": loop["error_views"], "plain_lag_ms": loop["lag_ms"]}
    return metrics


def variants(count: int) -> Iterator[Variant]:
    """Methods, filters and landmark noises, on the scripts with motion."""
    used = Track().filter
    best = METHODS[0]
    ways = [
        *((used, method, Setup(method=method)) for method in reversed(METHODS)),
        *(
            (name, best, Setup(track=Track(filter=name), method=best))
            for name in FILTER_MODULES
            if name != used
        ),
        *(
            ("other landmarks", f"{px:g} px", Setup(camera=Camera(noise_px=px)))
            for px in (0.15, 2 * NOISE_PX)
        ),
        ("plain loop", "nearest", plain_loop()),
        ("ideal viewpoint", "", Setup()),
    ]
    for curve, parameter, setup in ways:
        yield Variant(
            curve=curve,
            parameter=parameter,
            prepare=partial(_prepare, setup, count, curve == "ideal viewpoint"),
            paper=setup.track is None,
            used=(curve, parameter) == (used, best),
        )


@cache
def script_errors(setup: Setup, script: Script, count: int, ideal: bool) -> tuple[Errors, float]:
    """Errors of `count` pictures of a script, and of its viewpoints. ideal: pictures for the right
    viewpoints, without tracking.
    """
    run = watched(setup, script)
    at = samples(run, script, count)
    right = Truth(setup, script).at(run.ms[at])
    pictures = pictures_of(setup)
    keys = [pictures.key(views) for views in right] if ideal else [run.keys[k] for k in at]
    off = 0.0 if ideal else viewpoints(setup, script)["error_views"]
    return pictures.errors(keys, right), off


def _prepare(setup: Setup, count: int, ideal: bool) -> Prepared:
    """ideal: see `script_errors`."""
    scripts = [script for script in SCRIPTS if script.name in MOVING]
    simulated = [script_errors(setup, script, count, ideal) for script in scripts]
    usual = [script_errors(Setup(), script, count, False) for script in scripts]
    levels, usual_levels = (
        [float(errors.levels.mean()) for errors, _ in each] for each in (simulated, usual)
    )
    off = [views for _, views in simulated]
    metrics = {
        "error_levels": Value(float(np.mean(levels))),
        "error_seen": Value(float(np.mean([errors.seen.mean() for errors, _ in simulated]))),
        "error_views": Value(float(np.mean(off))),
        "ratio_levels": ratio_of(levels, usual_levels),
    }
    if not ideal:
        metrics["ratio_views"] = ratio_of(off, [views for _, views in usual])
    runs = [watched(setup, script) for script in scripts]
    choice_ms = 0.0 if ideal else float(np.median(np.concatenate([run.cpu_ms for run in runs])))
    pictures = pictures_of(setup)
    upcoming = itertools.cycle(
        [
            run.keys[k]
            for run, script in zip(runs, scripts, strict=True)
            for k in samples(run, script, count)
        ]
    )
    drawing_ms = partial(cpu_ms, lambda: pictures.draw(next(upcoming)), REPETITION_PICTURES)
    return metrics, lambda: {"picture_ms": choice_ms + drawing_ms()}


def _row(name: str, metrics: Metrics) -> Row:
    """A row with its values compared with their bounds."""
    return judged(Row(name, {key: Value(value) for key, value in metrics.items()}))
