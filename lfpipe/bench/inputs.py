"""Inputs of the subjects: a scene, a sequence of frames with or without true eyes, and a work
folder.
"""

import contextlib
import csv
import io
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.safe_files import replaced
from lfpipe.host.files import exists, is_file
from lfpipe.scene.lightfield import LightField
from lfpipe.sequence.eyes import COLUMNS, Truth, read_truth, table_of

Progress = Callable[[str, int, int], None]

HEAD = ("source_seq", "t_ns", *COLUMNS, "visible", "phase")  # of a table of true eyes
SIZE_PX = (640, 480)  # the frames that a session asks of a camera
# of the demo's sequence: quick and full; other sequences are cut to it
RATE_HZ = 30.0
STILL_S = 2.0
MOVING_S = (2.5, 10.0)
NOISE_DN = 2.0  # of a webcam in a room, by eye
DEMO_SIDE_PX = 256  # of the views of the quick demo scene: a quarter of the time of its full size


Picture = NDArray[np.uint8]


@attrs.frozen(eq=False, kw_only=True)
class FrameSequence:
    """frames: reads its frames, uint8 (height, width, 3) BGR, from the first on. truth: None if no
    table of true eyes is beside the video.
    """

    path: Path
    frames: Callable[[], Iterator[Picture]]
    count: int
    size_px: tuple[int, int]
    rate_hz: float
    truth: Truth | None


@attrs.define(eq=False, kw_only=True)
class Inputs:
    """Inputs, opened when a subject first asks for them. work: a folder for generated files, which
    later runs reuse.

    tracks: recorded head tracks for the made world. about: what is open, in words.
    """

    open_scene: Callable[[], tuple[Path, LightField]]
    open_sequence: Callable[[], FrameSequence]
    quick: bool
    work: Path
    tracks: tuple[Path, ...] = ()
    about: dict[str, str] = attrs.Factory(dict)

    @cached_property
    def scene(self) -> tuple[Path, LightField]:
        path, one = self.open_scene()
        views = f"{one.rows}x{one.cols} views of {one.width_px}x{one.height_px} px"
        self.about["scene"] = f"{one.name}: {views}, disparity {one.disparity_source}"
        return path, one

    @property
    def field(self) -> LightField:
        return self.scene[1]

    @cached_property
    def sequence(self) -> FrameSequence:
        one = self.open_sequence()
        truth = "truth known" if one.truth else "no truth"
        self.about["sequence"] = (
            f"{one.path.name}: {one.count} frames at {one.rate_hz:g} Hz, {truth}"
        )
        return one


def read_sequence(path: Path, most_frames: int) -> FrameSequence:
    """The first frames of a recorded sequence, a video, or pictures in a folder, and their truth:
    its own, or PATH with the suffix .csv. Raises UserError if one of them cannot be read.
    """
    from lfpipe.capture.recordings import open_recording
    from lfpipe.sequence.folder import is_sequence

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
    table = path.with_suffix(".csv")
    truth = None
    if is_sequence(path):
        truth = read_truth(path)
    elif is_file(table):
        truth = table_of(table)
    if truth is not None and len(truth.t_ns) < count:
        raise UserError(
            f"{path}: has the truth of {len(truth.t_ns)} of {count} frames",
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
    """Writes a video, every frame a JPEG, and the true eyes beside it. frames: (BGR of SIZE_PX,
    eyes (2, 2) px, whether they are visible, phase). Raises UserError.
    """
    quality = [cv2.VIDEOWRITER_PROP_QUALITY, 95]
    codec = cv2.VideoWriter.fourcc(*"MJPG")
    with replaced(path) as video, replaced(path.with_suffix(".csv")) as file:
        writer = cv2.VideoWriter(
            str(video.name), cv2.CAP_OPENCV_MJPEG, codec, rate_hz, SIZE_PX, quality
        )
        if not writer.isOpened():
            raise UserError(
                f"{path}: cannot be written",
                "name a file in a folder that is writable, on a disk with room",
            )
        table = csv.writer(io.TextIOWrapper(file, write_through=True, newline=""))
        table.writerow(HEAD)
        for seq, (frame, eyes, visible, phase) in enumerate(frames):
            writer.write(frame)
            pixels = (f"{value:.4f}" for value in eyes.ravel())
            table.writerow((seq, round(seq / rate_hz * 1e9), *pixels, int(visible), phase))
        writer.release()


def demo_sequence(folder: Path, moving_s: float) -> Path:
    """The demo's viewer as a video with its truth, generated if missing: still for STILL_S, then on
    the demo's path.

    Every frame has its own sensor noise: a still face would otherwise be a constant picture.
    """
    from lfpipe.capture.demo import DemoSource, demo_eyes_px

    path = folder / f"demo-{moving_s:g}s-{RATE_HZ:g}hz.avi"
    if is_file(path) and is_file(path.with_suffix(".csv")):
        return path
    folder.mkdir(parents=True, exist_ok=True)
    source = DemoSource(config.Camera(width_px=SIZE_PX[0], height_px=SIZE_PX[1], rate_hz=RATE_HZ))
    still = round(STILL_S * RATE_HZ)

    def frames() -> Iterator[tuple[Picture, NDArray[np.float64], bool, str]]:
        frame = np.empty((*SIZE_PX[::-1], 3), np.uint8)
        noise = np.empty((*SIZE_PX[::-1], 3), np.int16)
        cv2.setRNGSeed(1)
        for seq in range(still + round(moving_s * RATE_HZ)):
            if seq == 0 or seq > still:
                source.read(frame)
            cv2.randn(noise, np.zeros(3), np.full(3, NOISE_DN))
            eyes_px = demo_eyes_px(max(seq - still, 0) / RATE_HZ, *SIZE_PX)
            yield (
                np.asarray(cv2.add(frame, noise, dtype=cv2.CV_8U), np.uint8),
                eyes_px,
                True,
                "still" if seq <= still else "move",
            )

    write_video(path, RATE_HZ, frames())
    return path


def world_inputs(tracks: tuple[Path, ...], quick: bool) -> Inputs:
    """Inputs of the made world, which needs neither scene nor sequence."""

    def nothing() -> Any:
        raise ValueError("the made world has its own scenes and viewers")

    return Inputs(
        open_scene=nothing, open_sequence=nothing, quick=quick, work=Path(), tracks=tracks
    )


def make_inputs(
    scene: Path | None,
    sequence: Path | None,
    quick: bool,
    settings: config.Config,
    progress: Progress,
) -> Inputs:
    """The scene (a new one is packed) and the sequence; the demo's without them.

    Raises UserError if one does not exist.
    """
    from lfpipe.scene.cache import prepare_cache
    from lfpipe.scene.demo import demo_scene
    from lfpipe.scene.open_scene import open_scene

    if missing := [path for path in (scene, sequence) if path is not None and not exists(path)]:
        raise UserError(f"{missing[0]}: no such file or folder", "check the path")
    cache = prepare_cache(settings.scene)
    moving_s = MOVING_S[0 if quick else 1]
    work = cache / "bench"
    work.mkdir(exist_ok=True)

    def field() -> tuple[Path, LightField]:
        path = scene or (demo_scene(cache, size_px=DEMO_SIDE_PX) if quick else demo_scene(cache))
        return path, open_scene(path, settings.scene, progress)

    def frames() -> FrameSequence:
        return read_sequence(
            sequence or demo_sequence(work, moving_s), round((STILL_S + moving_s) * RATE_HZ)
        )

    return Inputs(open_scene=field, open_sequence=frames, quick=quick, work=work)
