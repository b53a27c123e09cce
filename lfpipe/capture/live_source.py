"""Live light fields: their names, and their sources: one camera, several in a row as one picture,
or the ring of another program.

    live:SOURCE[,SOURCE...][?layout=side-by-side|over-under|mosaic&grid=RxC&size=WxH]

SOURCE is a source of `spec.KINDS`, or a device file; its own parameters may follow. Several are
cameras in a row, from left to right.
"""

import math
import re
import time
from collections.abc import Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import Frame, FrameSource, SourceInfo
from lfpipe.capture.open_source import camera_name, definite_name, live_camera, probe_source
from lfpipe.capture.spec import LIVE, RingKind, RowKind, SourceKind, parse_source
from lfpipe.config import Config, LiveSource
from lfpipe.config.user_files import measured_placement
from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_area, fit_note, fitted
from lfpipe.live.shared_scene import attached, has_writer, two_cameras
from lfpipe.transport.clock import POLL_S, SECOND_NS, now_ns
from lfpipe.transport.ring import StampKind

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
        known = [frame for frame in frames if frame is not None]
        if len(known) < len(frames):
            return None
        for k, tile in enumerate(np.split(out, len(known), axis=1)):
            fitted(self._pictures[k], tile)
        stamps = [frame.t_sensor_ns for frame in known]
        return attrs.evolve(known[0], packet=None, offset_ns=max(stamps) - min(stamps))

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


WAIT_NS = SECOND_NS // 2  # until a timeout, before which the writer's end is noticed
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
        until_ns = now_ns() + WAIT_NS
        while now_ns() < until_ns:
            if (peeked := self._reader.peek()) is not None:
                stamp, record = peeked
                tiles = out.reshape(self._grid)
                np.copyto(tiles, record["views"].transpose(0, 2, 1, 3, 4))
                if self._reader.still_valid(stamp):
                    self._next_seq += 1
                    t_read_ns = now_ns()
                    return Frame(
                        self._next_seq - 1, stamp.t_sensor_ns, t_read_ns, stamp=StampKind.READ
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
SMALLEST_PX = 48  # of a view
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
    if frame_px[0] % across or frame_px[1] % down:
        raise UserError(
            f"{text}: a frame of {frame_px[0]}x{frame_px[1]} px is not divided by {down}x{across}"
            " views",
            "give the grid of the frame with grid=RxC, or its size with size=WxH",
        )
    if min(live.width_px, live.height_px) < SMALLEST_PX:
        raise UserError(
            f"{text}: views of {live.width_px}x{live.height_px} px are too small",
            f"use views of at least {SMALLEST_PX} px a side",
        )
    if not two_cameras(live):
        return live
    placement = measured_placement(camera_name(source), live.width_px)
    return attrs.evolve(live, placement=placement)


def check_devices(text: str, live: LiveSource, viewer: str) -> None:
    """Raises UserError if the camera of the light field is the source of the viewer."""
    if same_device(live.source, viewer):
        raise UserError(
            f"{text}: this camera already tracks your eyes",
            "name another camera for them with --camera, or use --camera mouse",
        )


def same_device(a: str, b: str) -> bool:
    """Whether two sources are one camera."""
    if not a or not b or not (parse_source(a).live and parse_source(b).live):
        return False
    one, other = (_cameras(parse_source(text), text) for text in (a, b))
    return not one.isdisjoint(other)


def _cameras(kind: SourceKind, text: str) -> set[str]:
    """The definite names of the cameras of a source."""
    if isinstance(kind, RowKind):
        return set(map(definite_name, kind.cameras, kind.names))
    return {definite_name(kind, text)}


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
    found = re.fullmatch(rf"(\d{{1,4}}){between}(\d{{1,4}})", text)
    if found is None or "0" in found.groups():
        raise UserError(f"{key}={text}: not two numbers", f"use for example {key}=3{between}3")
    return int(found[1]), int(found[2])


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
