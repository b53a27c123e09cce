"""Inputs of the benchmarks: a scene, a sequence of frames with or without true eyes, and a work
folder.
"""

import contextlib
import csv
import io
import os
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from pathlib import Path

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.recordings import FRAME_PX, DemoSource, demo_eyes_px, open_recording
from lfpipe.errors import UserError
from lfpipe.files.safe_files import replaced
from lfpipe.host.files import exists, is_file
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import demo_scene, open_scene, prepare_cache
from lfpipe.sequence.folder import is_sequence
from lfpipe.sequence.packets import COLUMNS, TRUTH, Truth, table_of
from lfpipe.supervisor.process_table import SCORER

Progress = Callable[[str, int, int], None]

HEAD = ("source_seq", "t_ns", *COLUMNS, "visible", "phase")  # of a table of true eyes
# of the demo sequence; longer ones are cut to its length
RATE_HZ = 30.0
STILL_S = 2.0
MOVING_S = (2.5, 10.0)  # quick and full
NOISE_DN = 2.0  # of an indoor webcam, visually estimated
DEMO_SIDE_PX = (256, 512)  # of a view of the demo scene: a quarter of the time, and its full size


Picture = NDArray[np.uint8]


@attrs.frozen(eq=False, kw_only=True)
class FrameSequence:
    """Recorded frames, with or without true eyes."""

    path: Path
    frames: Callable[[], Iterator[Picture]]
    """Reads the frames, uint8 (height, width, 3) BGR, from the first on."""
    count: int
    size_px: tuple[int, int]
    rate_hz: float
    truth: Truth | None
    """None if the video has no table of true eyes."""


@attrs.define(eq=False, kw_only=True, slots=False)
class Inputs:
    """Inputs, opened on first use.

    Raises UserError if a path does not exist.
    """

    scene_path: Path | None = None
    sequence_path: Path | None = None
    """None: the demo scene and sequence."""
    quick: bool
    settings: config.Config = attrs.Factory(config.Config)
    progress: Progress = lambda *_: None
    tracks: tuple[Path, ...] = ()
    """Recorded head tracks for the simulator."""
    about: dict[str, str] = attrs.Factory(dict)
    """Descriptions of the opened inputs, for the report."""

    def __attrs_post_init__(self) -> None:
        for path in (self.scene_path, self.sequence_path):
            if path is not None and not exists(path):
                raise UserError(f"{path}: no such file or folder", "check the path")

    @cached_property
    def work(self) -> Path:
        """A folder for generated files, which later runs reuse. Raises UserError."""
        return prepare_cache(self.settings.scene) / "bench"

    @cached_property
    def scene(self) -> Path:
        """The folder or file of the scene."""
        cache = self.work.parent
        size_px = DEMO_SIDE_PX[0 if self.quick else 1]
        return self.scene_path or demo_scene(cache, size_px=size_px)

    @cached_property
    def field(self) -> LightField:
        """The scene; a new one is packed. Raises UserError."""
        one = open_scene(self.scene, self.settings.scene, self.progress, scorer=SCORER)
        views = f"{one.rows}x{one.cols} views of {one.width_px}x{one.height_px} px"
        self.about["scene"] = f"{one.name}: {views}, disparity {one.disparity_source}"
        return one

    @cached_property
    def sequence(self) -> FrameSequence:
        """The frames. Raises UserError."""
        moving_s = MOVING_S[0 if self.quick else 1]
        path = self.sequence_path or demo_sequence(self.work, moving_s)
        one = read_sequence(path, round((STILL_S + moving_s) * RATE_HZ))
        frames = f"{one.count} frames at {one.rate_hz:g} Hz"
        truth = "with ground truth" if one.truth else "no ground truth"
        self.about["sequence"] = f"{one.path.name}: {frames}, {truth}"
        return one


def read_sequence(path: Path, most_frames: int) -> FrameSequence:
    """The first frames of a recorded sequence, a video, or pictures in a folder, and their ground
    truth: that of the sequence, or PATH with the suffix .csv. Raises UserError if any of them is
    unreadable.
    """

    def frames() -> Iterator[Picture]:
        with contextlib.closing(open_recording(path)) as recording:
            frame = np.empty((*recording.info.size_px[::-1], 3), np.uint8)
            for index in range(most_frames):
                if recording.read_into(index, frame) is None:
                    return
                yield frame.copy()

    with contextlib.closing(open_recording(path)) as recording:
        info = recording.info
    if not (count := sum(1 for _ in frames())):
        raise UserError(f"{path}: contains no frame", "record it again")
    table = path / TRUTH if is_sequence(path) else path.with_suffix(".csv")
    truth = table_of(table) if os.path.lexists(table) else None
    if truth is not None and len(truth.t_ns) < count:
        raise UserError(
            f"{path}: has true eyes for {len(truth.t_ns)} of {count} frames",
            "give one row per frame of the sequence",
        )
    return FrameSequence(
        path=path,
        frames=frames,
        count=count,
        size_px=info.size_px,
        rate_hz=info.rate_hz or config.Camera().nominal_hz,
        truth=truth,
    )


def write_video(
    path: Path, rate_hz: float, frames: Iterable[tuple[Picture, NDArray[np.float64], bool, str]]
) -> None:
    """Writes a video, every frame a JPEG, and its table of true eyes. frames: (BGR of FRAME_PX,
    eyes (2, 2) px, whether they are visible, phase). Raises UserError.
    """
    quality = [cv2.VIDEOWRITER_PROP_QUALITY, 95]
    codec = cv2.VideoWriter.fourcc(*"MJPG")
    with replaced(path) as video, replaced(path.with_suffix(".csv")) as file:
        writer = cv2.VideoWriter(
            str(video.name), cv2.CAP_OPENCV_MJPEG, codec, rate_hz, FRAME_PX, quality
        )
        if not writer.isOpened():
            raise UserError(
                f"{path}: cannot be written",
                "choose a file in a writable folder, and check free disk space",
            )
        table = csv.writer(io.TextIOWrapper(file, write_through=True, newline=""))
        table.writerow(HEAD)
        for seq, (frame, eyes, visible, phase) in enumerate(frames):
            writer.write(frame)
            pixels = (f"{value:.4f}" for value in eyes.ravel())
            table.writerow((seq, round(seq / rate_hz * 1e9), *pixels, int(visible), phase))
        writer.release()


def demo_sequence(folder: Path, moving_s: float) -> Path:
    """The demo viewer as a video with ground truth, generated if missing: still for STILL_S, then
    on the demo path.

    Every frame has its own sensor noise: a still face would otherwise be a constant picture.
    """
    path = folder / f"demo-{moving_s:g}s-{RATE_HZ:g}hz.avi"
    if is_file(path) and is_file(path.with_suffix(".csv")):
        return path
    folder.mkdir(parents=True, exist_ok=True)
    source = DemoSource(config.Camera(width_px=FRAME_PX[0], height_px=FRAME_PX[1], rate_hz=RATE_HZ))
    still = round(STILL_S * RATE_HZ)

    def frames() -> Iterator[tuple[Picture, NDArray[np.float64], bool, str]]:
        frame = np.empty((*FRAME_PX[::-1], 3), np.uint8)
        noise = np.empty((*FRAME_PX[::-1], 3), np.int16)
        cv2.setRNGSeed(1)
        for seq in range(still + round(moving_s * RATE_HZ)):
            if seq == 0 or seq > still:
                source.read(frame)
            cv2.randn(noise, np.zeros(3), np.full(3, NOISE_DN))
            eyes_px = demo_eyes_px(max(seq - still, 0) / RATE_HZ, *FRAME_PX)
            yield (
                np.asarray(cv2.add(frame, noise, dtype=cv2.CV_8U), np.uint8),
                eyes_px,
                True,
                "still" if seq <= still else "move",
            )

    write_video(path, RATE_HZ, frames())
    return path
