"""Every key with its type, default and meaning. `Opt` carries what the type cannot: unit, range, and whether a running session
takes the change (`live`).
"""

import math
from collections.abc import Mapping
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import attrs

AUTO_HZ = 60.0  # pictures a second without a screen that has a rate of its own


@attrs.frozen
class Opt:
    """What a value means and may be. low and high: range of a number, inclusive; without them every number is valid.
    live: `lfpipe ctl set` may change it, so the stage that uses the key must read `context.config` again."""

    doc: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    live: bool = False


@attrs.frozen
class Camera:
    source: Annotated[
        str,
        Opt(
            "camera:N, camera:/dev/videoN, camera:NAME, file:PATH[?loop=0|1&pace=recorded|max|HZ] or demo; empty: the first camera found"
        ),
    ] = ""
    width_px: Annotated[
        int,
        Opt(
            "frame width asked of the camera; frames of another size are scaled, those of another shape get black bars",
            "px",
            16,
            7680,
        ),
    ] = 640
    height_px: Annotated[int, Opt("frame height asked of the camera", "px", 16, 4320)] = 480
    rate_hz: Annotated[float, Opt("frame rate asked of the camera, and of a file without a rate of its own", "Hz", 0.1, 1000)] = (
        30.0
    )
    format: Annotated[
        Literal["auto", "MJPG", "YUYV", "UYVY", "NV12", "YU12", "BGR3", "RGB3", "GREY", "Y10"],
        Opt("pixel format requested of the camera; auto: uncompressed up to 640x480, MJPG above, or what there is"),
    ] = "auto"
    exposure: Annotated[float | Literal["auto"], Opt("exposure time; auto: leave it to the camera", "ms", 0.01, 1000)] = "auto"
    gain: Annotated[
        float | Literal["auto"], Opt("gain in the camera's own units; auto: leave it to the camera", "", 0, 65535)
    ] = "auto"
    power_line_hz: Annotated[
        Literal["auto", 0, 50, 60], Opt("mains frequency whose flicker the exposure avoids, 0 for none; auto: leave it", "Hz")
    ] = "auto"
    dynamic_framerate: Annotated[
        Literal["off", "on", "auto"], Opt("lets a camera lower its rate in dim light, until the session ends; auto: leave it")
    ] = "off"
    rotate: Annotated[
        Literal[0, 90, 180, 270], Opt("turns the picture clockwise, for a camera that is mounted upside down or sideways", "deg")
    ] = 0
    mirror: Annotated[bool, Opt("mirrors the picture, after the turn, for a driver that delivers it mirrored")] = False
    above_mm: Annotated[
        float,
        Opt("how far the camera stands above the middle of the picture on the screen", "mm", -2000, 2000, live=True),
    ] = 0.0
    tilt_deg: Annotated[float, Opt("how far the camera looks down", "deg", -60, 60, live=True)] = 0.0
    focal_px: Annotated[
        float | Literal["auto"],
        Opt(
            "focal length at width_px; auto: as `lfpipe calibrate` measured this camera, else from fov_deg",
            "px",
            1,
            100000,
            live=True,
        ),
    ] = "auto"
    fov_deg: Annotated[float, Opt("horizontal field of view, used while focal_px is auto", "deg", 5, 175, live=True)] = 56.0

    @property
    def frame_px(self) -> tuple[int, int]:
        """(width, height) of a frame after the turn."""
        upright = self.rotate % 180 == 0
        return (self.width_px, self.height_px) if upright else (self.height_px, self.width_px)


@attrs.frozen
class Track:
    engine: Annotated[
        Literal["litert", "mediapipe"], Opt("litert: the landmark network in-thread; mediapipe: FaceMesh, as in the paper")
    ] = "litert"
    filter: Annotated[
        Literal["predictive", "one-euro", "kalman", "mean"], Opt("smoothing of the eye positions; mean is the paper's", live=True)
    ] = "predictive"
    mean_k: Annotated[int, Opt("frames in the moving average of filter = mean", "frames", 1, 1000, live=True)] = 5
    refine: Annotated[
        bool,
        Opt("refine the eye centres with the iris network, and learn the viewer's own distance between the eyes from the iris"),
    ] = False


@attrs.frozen
class Render:
    clock: Annotated[
        Literal["display", "camera"],
        Opt("display: a picture for every refresh, eyes predicted to it; camera: one picture per camera frame, as in the paper"),
    ] = "display"
    rate_hz: Annotated[
        float | Literal["auto"],
        Opt("pictures a second of the display clock; auto: every refresh of the screen, 60 where there is none", "Hz", 1, 1000),
    ] = "auto"
    method: Annotated[
        Literal["auto", "nearest", "blend", "warp", "warp2"],
        Opt("how a view between the stored views is made; nearest is the paper's", live=True),
    ] = "auto"
    alpha_px: Annotated[
        float | Literal["auto", "true"],
        Opt(
            "camera pixels between neighbouring views of the grid; auto: from geometry and comfort; true: depth as in nature",
            "px",
            1e-9,
            1e9,
            live=True,
        ),
    ] = "auto"
    anaglyph: Annotated[
        Literal[
            "colour",
            "grey",
            "half-colour",
            "wimmer",
            "dubois",
            "dubois-green-magenta",
            "dubois-amber-blue",
            "mono",
            "side-by-side",
            "row-interleaved",
        ],
        Opt("how the two eyes' views share one picture; colour is the paper's", live=True),
    ] = "dubois"
    light: Annotated[
        Literal["linear", "gamma"], Opt("where matrices with cross terms are applied: linear light, or code values", live=True)
    ] = "linear"
    ghost_compensation: Annotated[
        float,
        Opt(
            "how much of the light that leaks through the other eye's glass is taken out; nothing with dubois-amber-blue",
            "%",
            0,
            100,
            live=True,
        ),
    ] = 0.0
    zero_plane_px: Annotated[float, Opt("disparity that lies in the plane of the screen", "px/view", -1000, 1000, live=True)] = (
        0.0
    )
    extrapolate_views: Annotated[float, Opt("how far beyond the grid the viewpoint may go", "views", 0, 16, live=True)] = 2.0
    swap_eyes: Annotated[bool, Opt("exchange the eyes, for glasses worn or printed the other way round", live=True)] = False
    loop_ms: Annotated[
        float,
        Opt(
            "the camera's delay before its stamp and the display's after the present, added to the prediction; `lfpipe calibrate --latency` measures it",
            "ms",
            0,
            1000,
            live=True,
        ),
    ] = 0.0
    loop_measured: Annotated[str, Opt("date, camera and monitor with which loop_ms was measured; empty: it was not")] = ""

    @property
    def nominal_hz(self) -> float:
        """rate_hz as a number, AUTO_HZ where the screen decides."""
        return AUTO_HZ if isinstance(self.rate_hz, str) else self.rate_hz


@attrs.frozen
class Screen:
    monitor: Annotated[
        int | str,
        Opt(
            "monitor for the window and for the full screen: its number or a part of its name, as `lfpipe doctor` lists them; empty: wherever the window is",
            "",
            0,
            63,
        ),
    ] = ""
    width_mm: Annotated[
        float | Literal["auto"],
        Opt(
            "width of the picture on the screen; auto: as the monitor tells its size, 530 where it does not",
            "mm",
            10,
            20000,
            live=True,
        ),
    ] = "auto"
    distance_mm: Annotated[
        float | Literal["auto"],
        Opt("viewer to screen; auto: from the distance between the eyes in the camera picture", "mm", 50, 50000, live=True),
    ] = "auto"


@attrs.frozen
class Scene:
    layout: Annotated[str, Opt("layout on disk; auto: detect it (`lfpipe scene info` shows it)")] = "auto"
    grid: Annotated[str, Opt("ROWSxCOLS where the files do not define it; empty: detect it")] = ""
    flip: Annotated[Literal["auto", "none", "rows", "cols", "both"], Opt("reverse the order of the views; auto: detect it")] = (
        "auto"
    )
    transpose: Annotated[Literal["auto", "no", "yes"], Opt("exchange rows and columns of the grid; auto: detect it")] = "auto"
    gamma: Annotated[
        float | Literal["auto"],
        Opt("screen value = stored value ** (1 / gamma), for pictures in linear light; 1 for none; auto: detect it", "", 0.1, 10),
    ] = "auto"
    force: Annotated[bool, Opt("open pictures that do not fit together as a light field")] = False
    cache_dir: Annotated[str, Opt("where packed scenes are kept; empty: the user's cache directory")] = ""


@attrs.frozen
class Governor:
    quality: Annotated[
        Literal["auto", "fixed"],
        Opt(
            "auto: where the machine is too slow, quality is lowered level by level, and raised when there is room; fixed: never",
            live=True,
        ),
    ] = "auto"
    affinity: Annotated[
        str,
        Opt(
            "cores of each stage, as in track=1,render=0+2; auto: on two cores tracking has one for itself; none: as the system will"
        ),
    ] = "auto"
    nice: Annotated[str, Opt("niceness of each stage, as in render=0,track=5; empty: as this process's")] = ""


@attrs.frozen
class Control:
    bind: Annotated[
        Literal["ipc"],
        Opt("where commands are taken: ipc, sockets in the run directory; from another machine: `ssh HOST lfpipe ctl`"),
    ] = "ipc"


@attrs.frozen
class Replay:
    latency_ms: Annotated[
        float,
        Opt(
            "sensor to light, as the prediction takes it where pictures do not depend on the clock: replay in steps, pace=max",
            "ms",
            0,
            1000,
        ),
    ] = 20.0


@attrs.frozen
class Config:
    """The whole tree. Immutable: a change is a new tree (`updated`)."""

    camera: Camera = Camera()
    track: Track = Track()
    render: Render = Render()
    screen: Screen = Screen()
    scene: Scene = Scene()
    governor: Governor = Governor()
    control: Control = Control()
    replay: Replay = Replay()


def options() -> dict[str, tuple[Any, Opt, Any]]:
    """Every dotted key with (type, Opt, default), in the order of the tree."""
    found: dict[str, tuple[Any, Opt, Any]] = {}
    for section in attrs.fields(Config):
        default = getattr(Config(), section.name)
        for name, hint in get_type_hints(type(default), include_extras=True).items():
            kind, opt = get_args(hint)
            found[f"{section.name}.{name}"] = (kind, opt, getattr(default, name))
    return found


def choices(key: str) -> tuple[str, ...]:
    """The words that key may be, in their order."""
    kind = options()[key][0]
    parts = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return tuple(word for part in parts if not isinstance(part, type) for word in get_args(part) if isinstance(word, str))


def trusted(tree: Mapping[str, Any]) -> Config:
    """The Config that `to_dict` made tree of, unchecked."""
    default = Config()
    return Config(**{name: type(getattr(default, name))(**values) for name, values in tree.items()})


def to_dict(config: Config) -> dict[str, Any]:
    """The tree as nested dicts of plain values, as messages and files carry it."""
    return attrs.asdict(config)
