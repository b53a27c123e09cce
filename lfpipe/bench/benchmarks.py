"""The benchmarks of `lfpipe bench`: the question, the columns, the charts and the decision of each.

`lfpipe/bench/NAME.py` runs the benchmark NAME. Its function `measure` yields variants, finished
tables, and texts that name omitted measurements with the reason. The runner interleaves the
repetitions of the variants and turns their results into rows.
"""

import attrs

from lfpipe.bench.results import Column


@attrs.frozen
class Choice:
    """The setting that a benchmark decides, by its first chart.

    Only methods with the same parameter as the one in use are options.
    """

    key: str
    """Configuration key."""
    limit: float
    """Limit of the cost."""
    reason: str
    """Reason for the limit."""
    difference: float
    """Minimum difference of the error that justifies another choice."""


@attrs.frozen(kw_only=True)
class Benchmark:
    """A command of `lfpipe bench`."""

    name: str
    title: str
    question: str
    columns: tuple[Column, ...] = ()
    charts: tuple[tuple[str, str], ...] = ()
    """Keys of the columns on the axes, (run time or similar, error): less is better in both."""
    paper: str = ""
    """The paper's method."""
    choice: Choice | None = None
    rounds: tuple[int, int] = (7, 25)
    """Repetitions of each method in a quick and in a full run."""

    def column(self, key: str) -> Column:
        return next(column for column in self.columns if column.key == key)


_ALL = (
    Benchmark(
        name="viewer",
        title="The picture of each eye",
        question="How much does the picture of each eye differ from the exact one for the true eyes"
        " at display time? A simulator provides the ground truth: viewers, cameras, screens and"
        " time are scripted.",
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
        title="Eye tracking",
        question="How closely does each face engine follow the true eyes of the sequence, at what"
        " CPU time per frame?",
        columns=(
            Column("error", "error of the worse eye, RMS", "% of the eye distance"),
            Column("offset", "offset of the eye centre", "of the eye distance"),
            Column("missed", "frames without a face", "share"),
            Column("cpu_ms", "CPU per camera frame, all threads", "ms"),
        ),
        charts=(("cpu_ms", "error"),),
        paper="FaceMesh (engine mediapipe) on every frame of 640x480",
        choice=Choice("track.engine", 11.0, "a third of a frame at 30 Hz", 1.0),
    ),
    Benchmark(
        name="synthesis",
        title="View synthesis",
        question="How well does each method predict held-out views, how evenly do they move, and"
        " how much CPU time does a picture take? Disparities are estimated from the kept views"
        " alone. A picture is the default anaglyph of both eyes, from the positions of the held-out"
        " views.",
        columns=(
            Column("rmse", "error on held-out views, RMSE", "levels"),
            Column("psnr_db", "PSNR on held-out views", "dB"),
            Column("jump", "largest over mean step of a sweep"),
            Column("cpu_ms", "thread CPU per picture", "ms"),
        ),
        charts=(("cpu_ms", "rmse"), ("cpu_ms", "jump")),
        paper="nearest stored view",
        choice=Choice("render.method", 8.0, "half a refresh at 60 Hz", 0.5),
    ),
    Benchmark(
        name="live",
        title="Live light fields",
        question="How well does each method draw a moving scene between two cameras that differ, at"
        " what CPU time per frame? Textured planes, boxes that move, thin bars, highlights and a"
        " blank wall; every picture is compared with the exact one. Peers: both views warped by"
        " OpenCV's DIS flow and cross-faded.",
        columns=(
            Column("rmse", "error of the views between, RMSE", "levels"),
            Column("psnr_db", "PSNR", "dB"),
            Column("still", "noise over time, nothing moves, camera noise of 2 levels", "levels"),
            Column("moving", "the same of the error, objects move", "levels"),
            Column("cpu_ms", "thread CPU per frame, without drawing", "ms"),
        ),
        charts=(("cpu_ms", "rmse"), ("cpu_ms", "still")),
        rounds=(2, 5),
    ),
    Benchmark(
        name="pipeline",
        title="The whole pipeline",
        question="How far is the viewpoint on screen from the eyes at that time, how old is its"
        " camera frame, and how much CPU time does it take? Sessions of lfpipe up, and the paper's"
        " pipeline as one plain loop, on the same video, decoded while they run.",
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
        question="Does anything lose precision, raise an exception or show a wrong picture, and for"
        " how long? The worst error is shown.",
    ),
)
BENCHMARKS = {benchmark.name: benchmark for benchmark in _ALL}
TABLE = Benchmark(
    name="table",
    title="View synthesis: quality against time",
    question="The protocol of angular super-resolution: the corners of 7x7 views are kept, the"
    " others synthesised and compared. Luma of BT.601 in studio range, peak 255; SSIM with a"
    " Gaussian of sigma 1.5; means over the synthesised views. Disparity is estimated from the kept"
    " views alone. One view in colour, one core.",
    columns=(
        Column("psnr_db", "PSNR", "dB"),
        Column("worst_db", "worst view", "dB"),
        Column("ssim", "SSIM"),
        Column("mb", "kept views and maps that it reads", "MB"),
        Column("ms", "thread CPU per picture", "ms"),
    ),
    rounds=(3, 3),
)
