"""Does the default filter do as well on motions and faces that its constants were not fitted to?

    uv run python profiling/eyes_heldout.py [--portraits FOLDER] [--tracks FOLDER] [--sequences 6] [--seconds 30]

tools/make_sequence.py generates sequences with other seeds, sensor noise and portraits (--portraits: pictures of one face each;
else the sample portrait). The landmark network measures every frame. Each filter then runs on the measurements as in a live
session: frames 4 ms old when tracked, refreshes at 60 Hz, composed 2 ms ahead, eyes predicted to the refresh.

--tracks holds CSV files of people who move through a 9x9 light field (Timestamp in ms, x, y in views, recorded when the view
changes). Their paths become eyes with 12 px per view, joined by monotone cubics, with 0.3 px of noise. It is unknown when these
people rested, so there is no jitter.

Each row holds error and still jitter of the paper's method (mean of five on camera frames) and of the default filter on the
display's clock, with their ratios.
"""

import csv
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from arguments import existing, parser_of, start
from numpy.typing import NDArray

from lfpipe.bench.eye_path import EyePath
from lfpipe.bench.trace_error import SIDES, AlignedTrace
from lfpipe.config import Track
from lfpipe.sequence.truth import Truth
from lfpipe.track.filters import make_filter
from lfpipe.track.litert_engine import LitertEngine
from lfpipe.track.smoothing import EyeFilter, Mean

TOOL = Path(__file__).parents[1] / "tools" / "make_sequence.py"
NOISES = (2.0, 5.0)
TRACKED_NS, COMPOSE_NS, REFRESH_NS = 4_000_000, 2_000_000, 16_666_667
VIEW_PX, MEASURED_PX, LONGEST_S, FINE_NS, FRAME_NS = 12.0, 0.3, 60.0, 3_333_333, 33_333_330


Measured = list[NDArray[np.float64] | None]


def measurements(video: Path) -> Measured:
    """Eyes (2, 2) px of every frame, by the landmark network."""
    engine, source, out = LitertEngine(), cv2.VideoCapture(str(video)), []
    while (frame := source.read()[1]) is not None:
        face = engine.detect(np.asarray(frame, np.uint8))
        out.append(None if face is None else face.eyes_px)
    return out


def on_screen(truth: EyePath, measured: Measured, filter_: EyeFilter, display: bool) -> tuple[float, float]:
    """Error and jitter in px of the eyes that pictures are made for (see `AlignedTrace`), on the display's or camera's clock."""
    rows = []
    tracked = [(i, int(truth.t_ns[i]), eyes) for i, eyes in enumerate(measured) if eyes is not None]
    due_ns = 3_000_000
    for k, (i, t_ns, eyes) in enumerate(tracked):
        position, _ = filter_.update(t_ns, eyes)
        ready_ns = t_ns + TRACKED_NS + COMPOSE_NS
        shown = [(ready_ns, position)]
        if display:
            due_ns += max(0, math.ceil((ready_ns - due_ns) / REFRESH_NS)) * REFRESH_NS
            next_ns = tracked[min(k + 1, len(tracked) - 1)][1] + TRACKED_NS + COMPOSE_NS
            times = range(due_ns, next_ns, REFRESH_NS)
            shown = [(time_ns, filter_.predict(time_ns)) for time_ns in times]
            due_ns += len(times) * REFRESH_NS
        for shown_ns, used in shown:
            eyes_used = dict(zip(SIDES, used.tolist(), strict=True))
            rows.append({"t_presented_ns": shown_ns, "t_sensor_ns": t_ns, "source_seq": i, "eyes_used": eyes_used})
    found = AlignedTrace(truth, rows).figures()
    return found["error"], found["jitter"]


def row(name: str, truth: EyePath, measured: Measured, stills: bool) -> tuple[float, float]:
    """Prints a row; returns (error ratio, jitter ratio)."""
    paper = on_screen(truth, measured, Mean(5), display=False)
    ours = on_screen(truth, measured, make_filter(Track()), display=True)
    error, jitter = ours[0] / paper[0], ours[1] / paper[1] if stills else float("nan")
    still = f"{paper[1]:9.3f}{ours[1]:8.3f}{jitter:7.2f}" if stills else ""
    print(f"{name:34}{paper[0]:9.2f}{ours[0]:8.2f}{error:7.3f}{still}", flush=True)
    return error, jitter


def paths_of(path: Path, smooth_ms: float) -> list[EyePath]:
    """Every stimulus of a track that lasts at least 5 s, at 30 Hz, smoothed by a Gaussian."""
    runs: dict[str, list[tuple[int, float, float]]] = {}
    with path.open(newline="") as file:
        for line in csv.DictReader(file):
            place = {key.strip().lower(): text.strip() for key, text in line.items() if key}
            runs.setdefault(place["stimulus"], []).append((int(float(place["timestamp"])), float(place["x"]), float(place["y"])))
    out = []
    for places in runs.values():
        points = [place for k, place in enumerate(places) if k == 0 or place[0] > places[k - 1][0]]
        span_s = (points[-1][0] - points[0][0]) / 1e3
        if len(points) < 10 or span_s < 5:
            continue
        t_ns = [(t_ms - points[0][0]) * 1_000_000 for t_ms, _, _ in points]
        at = np.array([[x, y] for _, x, y in points]) - 4
        middle = np.array([320.0, 240.0]) + at * (-VIEW_PX, VIEW_PX)
        eyes = middle[:, None] + np.array([[31.5, 0.0], [-31.5, 0.0]])
        sparse = EyePath(Truth(np.array(t_ns), eyes, np.ones(len(points), bool)))
        fine = np.arange(0, int(min(span_s, LONGEST_S) * 1e9), FINE_NS)
        path_px = sparse.at(fine).reshape(-1, 4)
        if smooth_ms:
            reach = int(4 * smooth_ms * 1e6 / FINE_NS)
            kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * FINE_NS / (smooth_ms * 1e6)) ** 2)
            padded = np.pad(path_px, ((reach, reach), (0, 0)), "edge")
            path_px = np.stack([np.convolve(column, kernel / kernel.sum(), "valid") for column in padded.T], axis=1)
        every = slice(None, None, FRAME_NS // FINE_NS)
        t_ns, kept_px = fine[every], path_px.reshape(-1, 2, 2)[every]
        out.append(EyePath(Truth(t_ns, kept_px, np.ones(len(t_ns), bool))))
    return out


def main() -> None:
    parser = parser_of(__doc__, seconds=30.0)
    parser.add_argument("--portraits", type=existing)
    parser.add_argument("--tracks", type=existing)
    parser.add_argument("--sequences", type=int, default=6, help="0 for tracks only")
    parser.add_argument("--smooth-ms", type=float, default=80.0, help="sigma of the Gaussian over tracks")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    pictures = sorted(path for path in args.portraits.iterdir() if path.suffix in (".jpg", ".png")) if args.portraits else [None]
    ratios = []
    print(f"{'':34}{'paper px':>9}{'px':>8}{'ratio':>7}{'still px':>9}{'px':>8}{'ratio':>7}")
    with tempfile.TemporaryDirectory() as folder:
        for k in range(args.sequences):
            portrait, noise = pictures[k * len(pictures) // args.sequences], NOISES[k % len(NOISES)]
            video = Path(folder, f"{k}.avi")
            words = [f"--seed={100 + k}", f"--noise={noise}", f"--seconds={args.seconds}"]
            words += [f"--portrait={portrait}"] if portrait else []
            subprocess.run([sys.executable, str(TOOL), str(video), *words], check=True, capture_output=True)
            name = f"seed {100 + k}, {portrait.stem if portrait else 'sample'}, noise {noise:g} DN"
            ratios.append(row(name, EyePath.read(video.with_suffix(".csv")), measurements(video), stills=True))
    rng = np.random.default_rng(1)
    for path in sorted(args.tracks.glob("*.csv")) if args.tracks else []:
        for k, truth in enumerate(paths_of(path, args.smooth_ms)):
            measured: Measured = [eyes + rng.normal(0, MEASURED_PX, (2, 2)) for eyes in truth.eyes_px]
            ratios.append(row(f"track {path.stem.removesuffix('_tracks')} {k}", truth, measured, stills=False))
    errors, jitters = np.array(ratios).T
    print(f"{len(ratios)} held out: error ratio median {np.median(errors):.3f}, worst {errors.max():.3f}", end="")
    print(f"; jitter ratio worst {np.nanmax(jitters):.2f}" if args.sequences else "")


if __name__ == "__main__":
    start(main)
