"""Opens a source by its name, also one that delivers all views of a live light field: one camera,
several in a row as one picture, or the ring of another program.

    live:SOURCE[,SOURCE...][?layout=side-by-side|over-under|mosaic&grid=RxC&size=WxH]

SOURCE is a source of `spec.KINDS`, or a device file; its own parameters may follow. Several are
cameras in a row, from left to right.

A camera may be unplugged, stall and return: readers wait with a limit and never block in the
driver. One thread makes all calls of the camera, because a dead device may block any of them: open,
read, even close. After a failure it opens the camera again: after BACKOFF_S, then after twice as
long each time, up to MAX_BACKOFF_S.
"""

import math
import queue
import re
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.camera_list import ANSWER_S, START_S, first_camera, with_time_limit
from lfpipe.capture.frame_source import (
    Frame,
    FrameSource,
    OrientedSource,
    SourceInfo,
    stall_s,
    undecodable,
)
from lfpipe.capture.spec import (
    LIVE,
    CameraSpec,
    FileSpec,
    RingKind,
    RowKind,
    SourceKind,
    parse_source,
)
from lfpipe.config import Config, LiveSource
from lfpipe.config.check import measured_placement
from lfpipe.config.session_options import (
    CameraViewer,
    Clock,
    Live,
    Lossless,
    RecordedEyes,
    Viewer,
)
from lfpipe.errors import UserError, redacted
from lfpipe.files.codecs import fit_area, fit_note, fitted
from lfpipe.host.worker import usable_cores
from lfpipe.live.records import attached, has_writer, two_cameras
from lfpipe.plugins import IN_USE, blaming
from lfpipe.scene.optical_flow import SMALLEST_PX
from lfpipe.transport.ring import POLL_S, SECOND_NS, StampKind, now_ns

WAIT_S = 0.1  # longest wait of `read`
BACKOFF_S, MAX_BACKOFF_S = 0.5, 5.0
# a driver call longer than this ends the process; five restarts take more than a minute
HUNG_S = CameraSpec.time_limit_s


class CameraLost(TimeoutError):
    """Raised once when frames stop, with the reason; TimeoutErrors follow until the next frame."""


class ReconnectingCamera:
    """An endless source.

    source_seq continues over all connections; info: of the camera as it was opened last.
    """

    def __init__(self, info: SourceInfo, open_: Callable[[], FrameSource]) -> None:
        """info: assumed until the camera is open. open_: opens it, or raises UserError.

        Returns when the camera has delivered a first frame, or failed, or has had the time for it.
        """
        self.info = info
        self._open = open_
        # where to write the next frame
        self._requests: queue.SimpleQueue[NDArray[np.uint8] | None] = queue.SimpleQueue()
        # one for each request
        self._answers: queue.SimpleQueue[Frame | Exception] = queue.SimpleQueue()
        self._requested = self._lost = False
        self._opened = threading.Event()
        self._ended = threading.Event()
        # start of the thread's present call; 0: it makes none
        self._called_ns = time.monotonic_ns()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        self._opened.wait(ANSWER_S + START_S)
        # when the last frame came, and the present one was requested
        self._fresh_ns = self._requested_ns = time.monotonic_ns()

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`; waits at most WAIT_S. out belongs to the thread until a frame has
        come: pass the same again.

        Raises CameraLost or TimeoutError without a frame, UserError if the driver blocks for
        HUNG_S.
        """
        if not self._requested:
            self._requested = True
            self._requested_ns = time.monotonic_ns()
            self._requests.put(out)
        try:
            answer = self._answers.get(timeout=WAIT_S)
        except queue.Empty:
            t_ns = time.monotonic_ns()
            called_ns = self._called_ns
            if called_ns and t_ns - called_ns > HUNG_S * 1e9:
                raise UserError(
                    f"{self.info.name}: its driver has not answered for {HUNG_S:g} s",
                    "unplug the camera and plug it in again",
                ) from None
            # a session that works less requests fewer frames
            silent_s = (t_ns - max(self._fresh_ns, self._requested_ns)) / 1e9
            # one whose driver answers says so itself, before
            if silent_s <= stall_s(self.info.rate_hz) + WAIT_S:
                raise TimeoutError from None
            raise self._no_frame(f"{self.info.name}: no frame for {silent_s:.1f} s") from None
        self._requested = False
        if isinstance(answer, UserError | TimeoutError):
            raise self._no_frame(getattr(answer, "message", str(answer)))
        if isinstance(answer, Exception):
            raise answer
        self._lost = False
        self._fresh_ns = time.monotonic_ns()
        return answer

    def _no_frame(self, why: str) -> TimeoutError:
        """The error to raise without a frame: CameraLost the first time."""
        first = not self._lost
        self._lost = True
        return CameraLost(why) if first else TimeoutError(why)

    def _run(self) -> None:
        backoff_s = BACKOFF_S
        next_seq = 0
        while not self._ended.is_set():
            source: FrameSource | None = None
            out: NDArray[np.uint8] | None = None
            self._called_ns = time.monotonic_ns()
            try:
                source = self._open()
                first_seq = next_seq
                self.info = source.info
                self._opened.set()
                while (out := self._requested_next()) is not None:
                    frame = source.read(out)
                    assert frame is not None, "a camera never ends"
                    next_seq = first_seq + frame.source_seq + 1
                    backoff_s = BACKOFF_S
                    self._answers.put(attrs.evolve(frame, source_seq=next_seq - 1))
                failure: Exception | None = None
            except (MemoryError, cv2.error) as error:
                failure = undecodable("camera", error)
            except Exception as error:  # raised by `read`, whatever it is
                failure = error
            if source is not None:
                source.close()  # before reporting
            self._called_ns = 0
            self._opened.set()
            if failure is not None and (out is not None or self._requests.get() is not None):
                self._answers.put(failure)
            self._ended.wait(backoff_s)
            backoff_s = min(2 * backoff_s, MAX_BACKOFF_S)

    def _requested_next(self) -> NDArray[np.uint8] | None:
        """Waits for the next request; None at the end."""
        self._called_ns = 0
        out = self._requests.get()
        self._called_ns = time.monotonic_ns()
        return out

    def close(self) -> None:
        """Closes the camera, unless its driver blocks."""
        self._ended.set()
        self._requests.put(None)
        self._thread.join(WAIT_S)


def resolve(text: str) -> SourceKind:
    """Parses text; an empty text selects the first camera.

    Raises UserError if text names no source, NoCamera if there is no camera at all.
    """
    return parse_source(text) if text else first_camera()


def definite_name(source: SourceKind, text: str) -> str:
    """The name of a source, and no longer "the first camera". text: the one that was parsed."""
    return str(source) if isinstance(source, CameraSpec) else text


def camera_name(text: str) -> str:
    """The name of a source in measurements: the driver's name of a camera, wherever it is plugged
    in.

    Raises UserError as `resolve` does.
    """
    return resolve(text).name_in_measurements(text)


def camera_settings(settings: config.Config) -> config.Camera:
    """[camera], at most at the rate that the session can use: FaceMesh takes most of a core at 30
    Hz, and two cores are busy with pictures.
    """
    camera = settings.camera
    slow = settings.track.engine == "mediapipe" or len(usable_cores()) <= 2
    return attrs.evolve(camera, rate_hz=camera.nominal_hz) if slow else camera


def live_camera(settings: config.Config, frame_px: tuple[int, int]) -> config.Camera:
    """[camera] for frames of a live light field, which no setting turns."""
    return attrs.evolve(
        settings.camera, width_px=frame_px[0], height_px=frame_px[1], rotate=0, mirror=False
    )


@blaming(IN_USE)
def open_source(text: str, camera: config.Camera, reconnect: bool = False) -> FrameSource:
    """Opens the source that text names, in a form of `spec.KINDS`, or the first camera for an empty
    text.

    camera.rotate and camera.mirror apply to cameras and videos; sequences were recorded upright.
    reconnect: retry a live source that cannot be opened or is lost later, see `ReconnectingCamera`.
    Raises UserError with the reason if it cannot be opened.
    """
    spec = CameraSpec() if reconnect and not text else resolve(text)
    if reconnect and spec.live:
        info = SourceInfo(
            redacted(str(spec)), (camera.width_px, camera.height_px), camera.nominal_hz, live=True
        )
        source: FrameSource = ReconnectingCamera(info, partial(spec.open, camera))
    else:
        source = spec.open(camera)
    turns = (camera.rotate or camera.mirror) and not spec.upright
    return OrientedSource(source, camera) if turns else source


@blaming(IN_USE)
def _tried(text: str, camera: config.Camera) -> SourceInfo:
    """Opens the source, reads the first frame of a recording, closes it.

    A camera is configured, but not started.
    """
    if (info := parse_source(text).probe(camera)) is not None:
        return attrs.evolve(info, jpeg=info.jpeg and not (camera.rotate or camera.mirror))
    try:
        source = open_source(text, camera)
    except (MemoryError, cv2.error) as error:
        raise undecodable(redacted(text), error) from None
    try:
        width_px, height_px = camera.frame_px
        source.read(np.empty((height_px, width_px, 3), np.uint8))
    finally:
        source.close()
    return source.info


def clock_of(text: str) -> Clock:
    """The clock of a session on a source: a file may ask for none. Raises UserError as
    `resolve` does.
    """
    source = resolve(text)
    return Lossless() if isinstance(source, FileSpec) and source.pace == "max" else Live()


def probe_source(text: str, camera: config.Camera) -> SourceInfo:
    """What the source delivers: opens it, decodes its first frame and closes it.

    Raises UserError as `open_source` does, and after its time limit.
    """
    spec = resolve(text)
    try:
        return with_time_limit(spec.time_limit_s, lambda: _tried(text, camera))
    except TimeoutError as error:
        raise UserError(f"{redacted(text)}: {error.strerror}", spec.remedy) from None


def check_source(text: str, camera: config.Camera) -> CameraViewer | RecordedEyes:
    """Opens the source, decodes its first frame and closes it: returns the viewer in it, with its
    definite name (a path for the first camera).

    Raises UserError as `open_source` does, and after its time limit.
    """
    spec = resolve(text)
    definite = definite_name(spec, text)
    info = probe_source(definite, camera)
    if info.eyes:
        return RecordedEyes(source=definite, rate_hz=info.rate_hz, folder=info.eyes)
    jpeg_px = info.size_px if info.jpeg else None
    return CameraViewer(
        source=definite,
        rate_hz=info.rate_hz,
        jpeg_px=jpeg_px,
        name=spec.name_in_measurements(definite),
    )


JITTER_NS = 2_000_000  # of stamps: a frame that is nearer by less is no better
MOST_SKIPPED = 8  # frames of a camera, whose driver may have kept as many


class RowSource:
    """Frames of cameras in a row: of each camera, the one that is nearest in time to those of the
    others.
    """

    def __init__(self, sources: Sequence[FrameSource], tile_px: tuple[int, int]) -> None:
        """sources: from left to right, open. tile_px: the most of a picture that one may take."""
        self._sources = sources
        first = sources[0].info
        _, _, width, height = fit_area(first.size_px, tile_px)
        self._periods_ns = [round(1e9 / max(source.info.rate_hz, 1.0)) for source in sources]
        self._pictures = [np.empty((height, width, 3), np.uint8) for _ in sources]
        sizes_px = {source.info.size_px for source in sources} - {(width, height)}
        scaled = [fit_note(size_px, (width, height)) for size_px in sorted(sizes_px)]
        notes = tuple(dict.fromkeys([*first.notes, *scaled]))
        name = ",".join(source.info.name for source in sources)
        self.info = attrs.evolve(
            first, name=name, size_px=(width * len(sources), height), jpeg=False, notes=notes
        )

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`."""
        frames = [self._next(k) for k in range(len(self._sources))]
        for _ in range(MOST_SKIPPED):
            if None in frames or not (late := self._late([f.t_sensor_ns for f in frames if f])):
                break
            for k in late:
                frames[k] = self._next(k)
        stamps = [frame.t_sensor_ns for frame in frames if frame is not None]
        if len(stamps) < len(frames) or (first := frames[0]) is None:
            return None
        for picture, tile in zip(self._pictures, np.split(out, len(frames), axis=1), strict=True):
            fitted(picture, tile)
        return attrs.evolve(first, packet=None, offset_ns=max(stamps) - min(stamps))

    def _next(self, k: int) -> Frame | None:
        return self._sources[k].read(self._pictures[k])

    def _late(self, stamps: list[int]) -> list[int]:
        """The cameras whose next frames are nearer to the frames of the others; [] if these frames
        are the nearest that there are.
        """
        order = sorted(range(len(stamps)), key=stamps.__getitem__)

        def spread_ns(late: int) -> int:
            after = [stamps[k] + self._periods_ns[k] * (k in order[:late]) for k in order]
            return max(after) - min(after)

        best = min(range(len(order)), key=spread_ns)
        return order[:best] if spread_ns(best) < spread_ns(0) - JITTER_NS else []

    def close(self) -> None:
        for source in self._sources:
            source.close()


RATE_HZ = 1.0  # that it draws at least: more slowly, it counts as stalled for a while


class RingSource:
    """The newest frames of the ring of a live scene."""

    def __init__(self, name: str) -> None:
        """Raises UserError if no program writes it."""
        self._name = name
        self._reader, (rows, cols), (width, height) = attached(name)
        if not has_writer(name):
            self._reader.close()
            raise UserError(f"ring:{name}: its program has ended", "start it again")
        self._grid = rows, height, cols, width, 3
        self._next_seq = 0
        size_px = cols * width, rows * height
        self.info = SourceInfo(f"ring:{name}", size_px, RATE_HZ, live=True)

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`. Raises UserError when the program has ended, or came back with
        other views.
        """
        if out.size != math.prod(self._grid):
            rows, height, cols, width, _ = self._grid
            raise UserError(
                f"ring:{self._name}: its program draws {rows}x{cols} views of {width}x{height} px"
                " now",
                "end this session and start it again",
            )
        until_ns = now_ns() + round(SECOND_NS / RATE_HZ)
        while now_ns() < until_ns:
            if (peeked := self._reader.peek()) is not None:
                stamp, record = peeked
                np.copyto(out.reshape(self._grid), record["views"].transpose(0, 2, 1, 3, 4))
                if self._reader.still_valid(stamp):
                    self._next_seq += 1
                    return Frame(
                        self._next_seq - 1, stamp.t_sensor_ns, now_ns(), stamp=StampKind.READ
                    )
            time.sleep(POLL_S)
        if not has_writer(self._name):
            raise UserError(f"ring:{self._name}: its program has ended", "start it again")
        raise TimeoutError

    def close(self) -> None:
        self._reader.close()


FORM = "live:SOURCE?layout=side-by-side|over-under|mosaic&grid=RxC&size=WxH"
LAYOUTS = {"side-by-side": ((1, 2), 2), "over-under": ((1, 2), 1)}  # grid, tiles across
WIDE = 2.2  # width over height of a frame, from which it holds two views side by side
OWN = ("layout", "grid", "size")  # parameters; others are the source's


def check_live(text: str, config: Config) -> LiveSource:
    """The live light field that text names, after its source was opened and closed.

    Raises UserError.
    """
    source, own = _split(text.removeprefix(LIVE))
    kind = parse_source(source)
    width, height = _pair(own, "size", "x") or config.camera.frame_px
    asked_px = width * (len(kind.cameras) if isinstance(kind, RowKind) else 1), height
    info = probe_source(source, live_camera(config, asked_px))
    frame_px = asked_px if "size" in own else info.size_px
    (rows, cols), across = _grid(text, source, own, frame_px)
    live = LiveSource(
        source=source,
        rows=rows,
        cols=cols,
        tiles_across=across,
        frame_px=frame_px,
        drawn=isinstance(kind, RingKind),
    )
    down = rows * cols // across
    small = min(live.width_px, live.height_px) < 2 * SMALLEST_PX  # disparity has half their size
    if small or frame_px[0] % across or frame_px[1] % down:
        raise UserError(
            f"{text}: a frame of {frame_px[0]}x{frame_px[1]} px is not {down}x{across} views of at"
            f" least {2 * SMALLEST_PX} px a side",
            "use larger views, or give the grid of the frame with grid=RxC, or its size with"
            " size=WxH",
        )
    if not two_cameras(live):
        return live
    return attrs.evolve(live, placement=measured_placement(camera_name(source), live.width_px))


def check_devices(text: str, live: LiveSource, viewer: Viewer) -> None:
    """Raises UserError if a camera of the light field is that of the viewer."""
    if not isinstance(viewer, CameraViewer) or not viewer.source:
        return
    views = parse_source(live.source)
    cameras = {definite_name(views, live.source)}
    if isinstance(views, RowKind):
        cameras = set(map(definite_name, views.cameras, views.names))
    if views.live and definite_name(parse_source(viewer.source), viewer.source) in cameras:
        raise UserError(
            f"{text}: this camera already tracks your eyes",
            "name another camera for them with --camera, or use --camera mouse",
        )


def _split(rest: str) -> tuple[str, dict[str, str]]:
    """The source and the parameters of the light field. Raises UserError."""
    name, _, query = rest.partition("?")
    pairs = [item.partition("=")[::2] for item in query.split("&") if item]
    own = {key: value for key, value in pairs if key in OWN}
    others = "&".join(f"{key}={value}" for key, value in pairs if key not in OWN)
    cameras = [f"camera:{one}" if one.startswith("/dev/") else one for one in name.split(",")]
    name = ",".join(cameras)
    if len(cameras) > 1:
        name = f"row:{name}"
    if not name:
        raise UserError(f"{LIVE}{rest}: names no source", f"use {FORM}")
    source = f"{name}?{others}" if others else name
    parse_source(source)
    return source, own


def _pair(own: dict[str, str], key: str, between: str) -> tuple[int, int] | None:
    """Two numbers of a parameter; None if it is not given. Raises UserError."""
    text = own.get(key)
    if text is None:
        return None
    numbers = re.fullmatch(rf"(\d{{1,4}}){between}(\d{{1,4}})", text)
    if numbers is None or "0" in numbers.groups():
        raise UserError(f"{key}={text}: not two numbers", f"use for example {key}=3{between}3")
    return int(numbers[1]), int(numbers[2])


def _grid(
    text: str, source: str, own: dict[str, str], frame_px: tuple[int, int]
) -> tuple[tuple[int, int], int]:
    """(rows, columns) of the light field, and its views across a frame. Raises UserError."""
    kind = parse_source(source)
    if isinstance(kind, RingKind):
        reader, grid, _ = attached(kind.name)
        reader.close()
        return grid, grid[1]
    if isinstance(kind, RowKind):
        return (1, len(kind.cameras)), len(kind.cameras)
    given = _pair(own, "grid", "x")
    layout = own.get("layout", "mosaic" if given else "")
    if not layout and frame_px[0] >= WIDE * frame_px[1]:
        layout = "side-by-side"
    if layout == "mosaic" and given is not None and given != (1, 1):
        return given, given[1]
    if layout in LAYOUTS and given in (None, (1, 2)):
        return LAYOUTS[layout]
    if not layout:
        problem = f"a frame of {frame_px[0]}x{frame_px[1]} px does not show how its views lie"
    else:
        problem = f"layout={layout}" + (f"&grid={own['grid']}" if given else "") + " is no layout"
    raise UserError(
        f"{text}: {problem}",
        "add ?layout=side-by-side, ?layout=over-under or ?layout=mosaic&grid=ROWSxCOLUMNS",
    )
