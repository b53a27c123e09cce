"""The subjects of `lfpipe bench`: what each answers, the columns of its rows, its charts, and what it decides.

`lfpipe/bench/NAME.py` measures the subject NAME: its function `measure` yields candidates, which the runner measures in turns and
makes rows of, finished tables, and texts that say what is left out and why.
"""

import attrs

from lfpipe.bench.results import Column

FILTER_RATES_HZ = (30, 60, 120)  # of cameras: usual, good, fast
AHEAD_MS = 40  # of the charts of filters: age of a picture at 30 Hz and 60 Hz refresh
NOISE_PX = 0.3  # of the landmarks of live faces: 0.22 to 0.34 px were measured at 640x480
LIGHT_MS = (20, 40, 60, 80, 100, 120, 140)  # from exposure to light
SHOWN_MS = 80  # of the chart of photon: a usual camera and display


@attrs.frozen
class Choice:
    """What a subject decides, by its first chart. key: of the configuration. limit: of the cost, with its reason.
    Only methods with the knob of the one in use are choices of the key."""

    key: str
    limit: float
    reason: str


@attrs.frozen
class Subject:
    """charts: keys of the columns on the axes, (run time or the like, error): less is better in both. paper: what the paper does.
    rounds: turns of each method in a quick and in a full run."""

    name: str
    title: str
    question: str
    columns: tuple[Column, ...] = ()
    charts: tuple[tuple[str, str], ...] = ()
    paper: str = ""
    choice: Choice | None = None
    rounds: tuple[int, int] = (7, 25)

    def column(self, key: str) -> Column:
        return next(column for column in self.columns if column.key == key)


_ALL = (
    Subject(
        "tracker", "Tracking the eyes",
        "How closely does each face engine follow the true eyes of the sequence, and what does a camera frame cost?",
        (
            Column("error_px", "error of the worse eye, RMS", "px of the frame"),
            Column("offset", "offset of the eye centre", "of the distance between the eyes"),
            Column("missed", "frames without a face", "share"), Column("time_ms", "time per camera frame", "ms"),
            Column("cpu_ms", "CPU per camera frame, all threads", "ms"),
        ),
        (("time_ms", "error_px"),), "FaceMesh (engine mediapipe) on every frame of 640x480",
        Choice("track.engine", 11.0, "a third of a frame at 30 Hz"),
    ),
    Subject(
        "filters", "Filtering and predicting",
        "How far are the filtered eyes that a picture is made for from the viewer's eyes when it is shown? A known motion"
        f" (reaches up to 450 mm/s, sway, sudden stops, approach, leaving the picture), landmarks with {NOISE_PX} px of noise.",
        (
            *(Column(f"error_{rate}hz", f"error {AHEAD_MS} ms ahead at {rate} Hz, RMS", "px") for rate in FILTER_RATES_HZ),
            *(Column(f"jitter_{rate}hz", f"still jitter at {rate} Hz, RMS", "px") for rate in FILTER_RATES_HZ),
            Column("time_us", "time per update", "µs"),
        ),
        (("time_us", "error_30hz"), ("jitter_30hz", "error_30hz")), "mean of k = 5, without prediction",
        Choice("track.filter", 1000.0, "a thirtieth of a frame at 30 Hz"),
    ),
    Subject(
        "photon", "Motion to photon",
        "How much later than the head do its pictures begin to move, and how far do they lag while it moves? The same known"
        " motion, camera at 30 Hz, display at 60 Hz, against the time from exposure to light.",
        (
            *(Column(f"onset_{h}ms", f"latency at onset, light {h} ms after exposure", "ms") for h in LIGHT_MS),
            *(Column(f"steady_{h}ms", f"steady latency, light {h} ms after exposure", "ms") for h in LIGHT_MS),
            *(Column(f"error_{h}ms", f"displayed error, RMS, light {h} ms after exposure", "px") for h in LIGHT_MS),
        ),
        ((f"onset_{SHOWN_MS}ms", f"error_{SHOWN_MS}ms"),), "mean of k = 5, without prediction",
    ),
    Subject(
        "judder", "Pictures shown twice or left out",
        "How many pictures miss the blank of a simulated screen that they were made for, and does video play evenly?",
    ),
    Subject(
        "synthesis", "Views between the stored ones",
        "How well does each method make views that were left out, how evenly do they move, and what does a picture cost?"
        " Disparities are estimated from the kept views alone. A picture is an anaglyph of both eyes, between the stored views.",
        (
            Column("rmse", "error on left-out views, RMSE", "levels"), Column("psnr_db", "PSNR on left-out views", "dB"),
            Column("jump", "largest over mean step of a sweep"), Column("time_ms", "time per picture", "ms"),
        ),
        (("time_ms", "rmse"), ("time_ms", "jump")), "nearest stored view",
        Choice("render.method", 8.0, "half a refresh at 60 Hz"),
    ),
    Subject(
        "anaglyph", "Anaglyph encodings",
        "What do both eyes see through simulated glasses? For views of the scene: error of the fused colour, difference in"
        " lightness between the eyes, and the other eye's light on mid grey.",
        (
            Column("fused", "error of the fused colour", "CIELAB"), Column("rivalry", "rivalry between the eyes", "L*"),
            Column("ghost", "ghost of the other eye on grey", "% of its light"),
            Column("time_ms_mp", "time per megapixel", "ms"),
        ),
        (("time_ms_mp", "fused"), ("time_ms_mp", "rivalry"), ("time_ms_mp", "ghost")),
        "colour: red of the left view, green and blue of the right",
    ),
    Subject(
        "pipeline", "The whole pipeline",
        "How far is the viewpoint on screen from the eyes at that moment, how old is the frame behind it, and how much CPU does"
        " it take? Sessions of lfpipe up, and the paper as one plain loop, on the same video, which they decode as they run.",
        (
            Column("error_views", "error of the viewpoint shown, RMS", "views"),
            Column("error_px", "error of the eyes the picture was made for, RMS", "px"),
            Column("jitter_px", "still jitter, RMS", "px"), Column("latency_ms", "frame captured to picture shown, p50", "ms"),
            Column("latency_p95_ms", "frame captured to picture shown, p95", "ms"),
            Column("cpu_ms_s", "CPU of all processes", "ms per second"), Column("first_s", "start to first picture", "s"),
        ),
        (("cpu_ms_s", "error_views"), ("latency_ms", "error_views"), ("cpu_ms_s", "latency_ms")),
        "its configuration (--config paper), and the same as one plain loop", rounds=(1, 3),
    ),
    Subject(
        "stability", "Stiff and extreme cases",
        "Does anything lose precision, raise an exception or show a wrong picture, and for how long? The worst error is shown.",
    ),
)  # fmt: skip
SUBJECTS = {subject.name: subject for subject in _ALL}
TABLE = Subject(
    "table", "Views between: quality over time",
    "The protocol of angular super-resolution: the corners of 7x7 views are kept, the others made and compared. Luma of BT.601 in"
    " studio range, peak 255; SSIM with a Gaussian of sigma 1.5; means over the made views. Disparity is of the kept views alone."
    " One view in colour, one core.",
    (Column("psnr_db", "PSNR", "dB"), Column("worst_db", "worst view", "dB"), Column("ssim", "SSIM"),
     Column("ms", "time per picture", "ms")),
    rounds=(3, 3),
)  # fmt: skip
