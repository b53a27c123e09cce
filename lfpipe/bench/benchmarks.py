"""The benchmarks of `lfpipe bench`: the question, the columns, the charts and the decision of each.

`lfpipe/bench/NAME.py` runs the benchmark NAME: its function `measure` yields variants, whose
repetitions the runner interleaves and makes rows of, finished tables, and texts that say what is
left out and why.
"""

import attrs

from lfpipe.bench.results import Column


@attrs.frozen
class Choice:
    """What a benchmark decides, by its first chart.

    Only methods with the parameter of the one in use are choices of the key.
    """

    key: str
    """Of the configuration."""
    limit: float
    """Of the cost."""
    reason: str
    """Of the limit."""
    difference: float
    """The least difference of the error that is worth another choice."""


@attrs.frozen(kw_only=True)
class Benchmark:
    """A command of `lfpipe bench`."""

    name: str
    title: str
    question: str
    columns: tuple[Column, ...] = ()
    charts: tuple[tuple[str, str], ...] = ()
    """Keys of the columns on the axes, (run time or the like, error): less is better in both."""
    paper: str = ""
    """What the paper does."""
    choice: Choice | None = None
    rounds: tuple[int, int] = (7, 25)
    """Repetitions of each method in a quick and in a full run."""

    def column(self, key: str) -> Column:
        return next(column for column in self.columns if column.key == key)


_ALL = (
    Benchmark(
        name="viewer",
        title="What each eye sees",
        question="How far is the picture of each eye from the exact one for the true eyes at the"
        " time it is seen? A simulator has the ground truth: viewers, cameras, screens and time"
        " are scripted.",
        columns=(
            Column("error_levels", "error of each eye's picture, RMS", "levels"),
            Column("error_seen", "the same through the glasses", "L*"),
            Column("error_views", "error of the viewpoint", "views"),
            Column("ratio_levels", "error of pictures / the default's, over scripts"),
            Column("ratio_views", "error of viewpoints / the default's, over scripts"),
            Column("picture_ms", "thread CPU per picture", "ms"),
        ),
        charts=(("picture_ms", "error_levels"), ("picture_ms", "error_views")),
        paper="mean of 5 frames, a picture per frame, nearest views",
        choice=Choice("track.filter", 8.0, "half a refresh at 60 Hz", 0.5),
    ),
    Benchmark(
        name="tracker",
        title="Tracking the eyes",
        question="How closely does each face engine follow the true eyes of the sequence, and"
        " what does a"
        " camera frame cost?",
        columns=(
            Column("error", "error of the worse eye, RMS", "% of the eye distance"),
            Column("offset", "offset of the eye centre", "of the distance between the eyes"),
            Column("missed", "frames without a face", "share"),
            Column("cpu_ms", "CPU per camera frame, all threads", "ms"),
        ),
        charts=(("cpu_ms", "error"),),
        paper="FaceMesh (engine mediapipe) on every frame of 640x480",
        choice=Choice("track.engine", 11.0, "a third of a frame at 30 Hz", 1.0),
    ),
    Benchmark(
        name="synthesis",
        title="Views between the stored ones",
        question="How well does each method make views that were left out, how evenly do they"
        " move, and what"
        " does a picture cost? Disparities are of the kept views alone. A picture is the"
        " default anaglyph of both eyes, from the places of the left-out views.",
        columns=(
            Column("rmse", "error on left-out views, RMSE", "levels"),
            Column("psnr_db", "PSNR on left-out views", "dB"),
            Column("jump", "largest over mean step of a sweep"),
            Column("cpu_ms", "thread CPU per picture", "ms"),
        ),
        charts=(("cpu_ms", "rmse"), ("cpu_ms", "jump")),
        paper="nearest stored view",
        choice=Choice("render.method", 8.0, "half a refresh at 60 Hz", 0.5),
    ),
    Benchmark(
        name="pipeline",
        title="The whole pipeline",
        question="How far is the viewpoint on screen from the eyes at that moment, how old is the"
        " frame behind it, and how much CPU does it take? Sessions of lfpipe up, and the paper as"
        " one plain loop, on the same video, which they decode as they run.",
        columns=(
            Column("error_views", "error of the viewpoint shown, RMS", "views"),
            Column("error_px", "error of the eyes the picture was made for, RMS", "px"),
            Column("jitter_px", "still jitter, RMS", "px"),
            Column("latency_ms", "frame captured to picture shown, p50", "ms"),
            Column("latency_p95_ms", "frame captured to picture shown, p95", "ms"),
            Column("cpu_ms_s", "CPU of all processes", "ms per second"),
            Column("first_s", "start to first picture", "s"),
        ),
        charts=(
            ("cpu_ms_s", "error_views"),
            ("latency_ms", "error_views"),
            ("cpu_ms_s", "latency_ms"),
        ),
        paper="its configuration (--config paper), and the same as one plain loop",
        rounds=(1, 3),
    ),
    Benchmark(
        name="grid",
        title="Spacing of the grid",
        question="How do dense and sparse grids trade the movement zone against responsiveness,"
        " for near and far viewers? Cameras 20 mm apart, focused at 1 m; comfort: at most 1 degree"
        " of disparity.",
        columns=(
            Column("zone_mm", "movement zone", "mm"),
            Column("zone_deg", "the same", "degrees"),
            Column("views_per_cm", "views passed per cm of head movement"),
            Column("depth", "depth", "% of true depth"),
            Column("disparity_deg", "largest disparity on the screen", "degrees"),
            Column("step_nearest", "largest step in 1 cm, nearest", "levels"),
            Column("step_warp2", "largest step in 1 cm, warp2", "levels"),
            Column("error_levels", "error of each eye's picture, swaying", "levels"),
        ),
        charts=(("views_per_cm", "zone_mm"),),
        paper="alpha fixed at 12 px",
        rounds=(1, 1),
    ),
    Benchmark(
        name="stability",
        title="Stiff and extreme cases",
        question="Does anything lose precision, raise an exception or show a wrong picture,"
        " and for how"
        " long? The worst error is shown.",
    ),
)
BENCHMARKS = {benchmark.name: benchmark for benchmark in _ALL}
TABLE = Benchmark(
    name="table",
    title="Views between: quality over time",
    question="The protocol of angular super-resolution: the corners of 7x7 views are kept,"
    " the others made"
    " and compared. Luma of BT.601 in studio range, peak 255; SSIM with a Gaussian of sigma 1.5;"
    " means over the made views. Disparity is of the kept views alone. One view in colour, one"
    " core.",
    columns=(
        Column("psnr_db", "PSNR", "dB"),
        Column("worst_db", "worst view", "dB"),
        Column("ssim", "SSIM"),
        Column("mb", "kept views and maps that it reads", "MB"),
        Column("ms", "thread CPU per picture", "ms"),
    ),
    rounds=(3, 3),
)
