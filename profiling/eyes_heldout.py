"""Does the default filter do as well on motions and faces that its constants were not fitted on?

    uv run python profiling/eyes_heldout.py [--portraits FOLDER] [--tracks FOLDER] [--sequences 6] [--seconds 30]

Sequences of other seeds, portraits (--portraits, pictures of one face each; else the sample portrait) and sensor noise are
made with tools/make_sequence.py, every frame is measured by the landmark network, and filters run as in eyes_filters.py.
--tracks holds CSV files of people moving through a 9x9 light field (Timestamp in ms, x, y in views, told when the view
changes): their paths become eyes of 12 px a view, joined by monotone cubics and measured with 0.3 px of noise, for there are
no frames of them; nobody knows when they rested, so no jitter is told. Each row: error and still jitter of the paper's way,
the mean of five on camera frames, and of the default filter on the display's clock, with their ratio.
"""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from arguments import parser_of
from eyes_filters import measurements, on_screen
from numpy.typing import NDArray

from lfpipe.bench.truth import Truth
from lfpipe.config import Track
from lfpipe.track.filters import make_filter
from lfpipe.track.smoothing import Mean

TOOL = Path(__file__).parents[1] / "tools" / "make_sequence.py"
NOISES = (2.0, 5.0)
VIEW_PX, MEASURED_PX, LONGEST_S, FINE_NS, FRAME_NS = 12.0, 0.3, 60.0, 3_333_333, 33_333_330


def row(name: str, truth: Truth, measured: list[NDArray[np.float64] | None], stills: bool) -> tuple[float, float]:
    """Prints a row; (error ratio, jitter ratio)."""
    paper = on_screen(truth, measured, Mean(5), display=False)
    ours = on_screen(truth, measured, make_filter(Track()), display=True)
    error, jitter = ours[0] / paper[0], ours[1] / paper[1] if stills else float("nan")
    told = f"{paper[1]:9.3f}{ours[1]:8.3f}{jitter:7.2f}" if stills else ""
    print(f"{name:34}{paper[0]:9.2f}{ours[0]:8.2f}{error:7.3f}{told}", flush=True)
    return error, jitter


def walked(path: Path, smooth_ms: float) -> list[Truth]:
    """Every stimulus of a track that lasts 5 s or longer, at 30 Hz, smoothed by a Gaussian."""
    runs: dict[str, list[tuple[int, float, float]]] = {}
    with path.open(newline="") as file:
        for line in csv.DictReader(file):
            place = {key.strip().lower(): text.strip() for key, text in line.items() if key}
            runs.setdefault(place["stimulus"], []).append((int(float(place["timestamp"])), float(place["x"]), float(place["y"])))
    out = []
    for places in runs.values():
        kept = [place for k, place in enumerate(places) if k == 0 or place[0] > places[k - 1][0]]
        span_s = (kept[-1][0] - kept[0][0]) / 1e3
        if len(kept) < 10 or span_s < 5:
            continue
        t_ns = [(t_ms - kept[0][0]) * 1_000_000 for t_ms, _, _ in kept]
        at = np.array([[x, y] for _, x, y in kept]) - 4
        middle = np.array([320.0, 240.0]) + at * (-VIEW_PX, VIEW_PX)
        eyes = middle[:, None] + np.array([[31.5, 0.0], [-31.5, 0.0]])
        sparse = Truth(t_ns, eyes, [True] * len(kept), [False] * len(kept))
        fine = np.arange(0, int(min(span_s, LONGEST_S) * 1e9), FINE_NS)
        path_px = sparse.at(fine).reshape(-1, 4)
        if smooth_ms:
            reach = int(4 * smooth_ms * 1e6 / FINE_NS)
            kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * FINE_NS / (smooth_ms * 1e6)) ** 2)
            padded = np.pad(path_px, ((reach, reach), (0, 0)), "edge")
            path_px = np.stack([np.convolve(column, kernel / kernel.sum(), "valid") for column in padded.T], axis=1)
        every = slice(None, None, FRAME_NS // FINE_NS)
        t_ns, kept_px = fine[every], path_px.reshape(-1, 2, 2)[every]
        out.append(Truth(t_ns, kept_px, [True] * len(t_ns), [False] * len(t_ns)))
    return out


def main() -> None:
    parser = parser_of(__doc__, seconds=30.0)
    parser.add_argument("--portraits", type=Path)
    parser.add_argument("--tracks", type=Path)
    parser.add_argument("--sequences", type=int, default=6, help="0 for tracks alone")
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
            ratios.append(row(name, Truth.read(video.with_suffix(".csv")), measurements(video), stills=True))
    rng = np.random.default_rng(1)
    for path in sorted(args.tracks.glob("*.csv")) if args.tracks else []:
        for k, truth in enumerate(walked(path, args.smooth_ms)):
            measured: list[NDArray[np.float64] | None] = [eyes + rng.normal(0, MEASURED_PX, (2, 2)) for eyes in truth.eyes_px]
            ratios.append(row(f"track {path.stem.removesuffix('_tracks')} {k}", truth, measured, stills=False))
    errors, jitters = np.array(ratios).T
    print(f"{len(ratios)} held out: error ratio median {np.median(errors):.3f}, worst {errors.max():.3f}", end="")
    print(f"; jitter ratio worst {np.nanmax(jitters):.2f}" if args.sequences else "")


if __name__ == "__main__":
    main()
