"""Names of live light fields, and what their sources deliver.

    live:SOURCE[,SOURCE...][?layout=side-by-side|over-under|mosaic&grid=RxC&size=WxH]

SOURCE is a source of `spec.KINDS`, or a device file; its own parameters may follow. Several are
cameras in a row, from left to right.
"""

import re

import attrs

from lfpipe.capture.open_source import camera_name, definite_name, live_camera, probe_source
from lfpipe.capture.spec import LIVE, RingKind, RowKind, SourceKind, parse_source
from lfpipe.config import Config, LiveSource
from lfpipe.config.user_files import measured_placement
from lfpipe.errors import UserError
from lfpipe.live.shared_scene import attached, two_cameras

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
