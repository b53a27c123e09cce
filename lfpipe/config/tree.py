"""Every key with its type, default and meaning. `Opt` adds unit, range, and whether the key can change while a session runs
(`live`).
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import attrs

AUTO_HZ = 60.0  # pictures per second without a screen


@attrs.frozen
class Opt:
    """Meaning and limits of a value. low and high: range of a number, inclusive; without them every number is valid.
    live: `lfpipe ctl set` may change it, so the stage that uses the key must reread `context.config`. replays: whether it can
    change what a replay computes."""

    doc: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    live: bool = False
    replays: bool = True


@attrs.frozen
class Camera:
    source: Annotated[
        str,
        Opt(
            "camera:N, camera:/dev/videoN, camera:NAME, file:PATH[?loop=0|1&pace=recorded|max|HZ] or demo; empty: the first camera found",
            replays=False,
        ),
    ] = ""
    width_px: Annotated[
        int,
        Opt(
            "frame width requested from the camera; frames of another size are scaled, frames of another aspect ratio get black bars",
            "px",
            16,
            7680,
        ),
    ] = 640
    height_px: Annotated[int, Opt("frame height requested from the camera", "px", 16, 4320)] = 480
    rate_hz: Annotated[
        float, Opt("frame rate requested from the camera, and used for a file without a rate of its own", "Hz", 0.1, 1000)
    ] = 30.0
    format: Annotated[
        Literal["auto", "MJPG", "YUYV", "UYVY", "NV12", "YU12", "BGR3", "RGB3", "GREY", "Y10"],
        Opt(
            "pixel format requested from the camera; auto: the one that reaches the size, then the rate, then the cheapest to decode",
            replays=False,
        ),
    ] = "auto"
    exposure: Annotated[float | Literal["auto"], Opt("exposure time; auto: the camera decides", "ms", 0.01, 1000)] = "auto"
    gain: Annotated[float | Literal["auto"], Opt("gain in the camera's own units; auto: the camera decides", "", 0, 65535)] = (
        "auto"
    )
    power_line_hz: Annotated[
        Literal["auto", 0, 50, 60],
        Opt("mains frequency whose flicker the exposure avoids, 0 for none; auto: leave the camera's setting", "Hz"),
    ] = "auto"
    dynamic_framerate: Annotated[
        Literal["off", "on", "auto"],
        Opt("let a camera lower its rate in dim light, until the session ends; auto: leave the camera's setting"),
    ] = "off"
    rotate: Annotated[
        Literal[0, 90, 180, 270], Opt("turn the picture clockwise, for a camera mounted upside down or sideways", "deg")
    ] = 0
    mirror: Annotated[bool, Opt("mirror the picture, after the turn, for a driver that delivers it mirrored")] = False
    above_mm: Annotated[
        float, Opt("height of the camera above the middle of the picture on the screen", "mm", -2000, 2000, live=True)
    ] = 0.0
    tilt_deg: Annotated[float, Opt("angle by which the camera looks down", "deg", -60, 60, live=True)] = 0.0
    focal_px: Annotated[
        float | Literal["auto"],
        Opt("focal length at width_px; auto: measured by `lfpipe calibrate`, else from fov_deg", "px", 1, 100000, live=True),
    ] = "auto"
    fov_deg: Annotated[
        float, Opt("horizontal field of view, used if focal_px is auto and was not measured", "deg", 5, 175, live=True)
    ] = 56.0

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
        Opt(
            "display: a picture for every refresh, eyes predicted to it; camera: one picture per camera frame, as in the paper",
            replays=False,
        ),
    ] = "display"
    rate_hz: Annotated[
        float | Literal["auto"],
        Opt(
            "pictures per second of the display clock; auto: every refresh of the screen, 60 without a screen",
            "Hz",
            1,
            1000,
            replays=False,
        ),
    ] = "auto"
    method: Annotated[
        Literal["auto", "nearest", "blend", "warp", "warp2", "best"],
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
    depth: Annotated[
        float,
        Opt(
            "depth from comfort (0) to true (1), or to the whole grid where true is unknown; with alpha_px auto",
            "",
            0,
            1,
            live=True,
        ),
    ] = 0.0
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
            "share of the light leaking through the other eye's glass that is subtracted; no effect with dubois-amber-blue",
            "%",
            0,
            100,
            live=True,
        ),
    ] = 0.0
    zero_plane_px: Annotated[
        float | Literal["auto"],
        Opt(
            "disparity of points in the plane of the screen; auto: that of the nearest at the picture's left and right border",
            "px/view",
            -1000,
            1000,
            live=True,
        ),
    ] = "auto"
    extrapolate_views: Annotated[float, Opt("how far beyond the grid the viewpoint may go", "views", 0, 16, live=True)] = 2.0
    keep_depth: Annotated[
        bool,
        Opt(
            "at the edge of the grid, keep the distance of the eyes and stop their middle; no: stop each eye, as the paper does",
            live=True,
        ),
    ] = True
    swap_eyes: Annotated[bool, Opt("swap the eyes, for glasses worn or printed the other way round", live=True)] = False
    loop_ms: Annotated[
        float,
        Opt(
            "delay of the camera before its stamp plus delay of the display after the present; prediction adds it; `lfpipe calibrate --latency` measures it",
            "ms",
            0,
            1000,
            live=True,
            replays=False,
        ),
    ] = 0.0
    loop_measured: Annotated[
        str, Opt("date, camera and monitor of the measurement of loop_ms; empty: not measured", replays=False)
    ] = ""

    @property
    def nominal_hz(self) -> float:
        """rate_hz as a number; AUTO_HZ if the screen decides."""
        return AUTO_HZ if isinstance(self.rate_hz, str) else self.rate_hz


@attrs.frozen
class Screen:
    monitor: Annotated[
        int | str,
        Opt(
            "monitor for the window and for full screen: its number or part of its name, as `lfpipe doctor` lists them; empty: the window's own",
            "",
            0,
            63,
            replays=False,
        ),
    ] = ""
    width_mm: Annotated[
        float | Literal["auto"],
        Opt(
            "width of the picture on the screen; auto: from the monitor's reported size, 530 if unknown",
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
    grid: Annotated[str, Opt("ROWSxCOLS, if the files do not define it; empty: detect it")] = ""
    flip: Annotated[Literal["auto", "none", "rows", "cols", "both"], Opt("reverse the order of the views; auto: detect it")] = (
        "auto"
    )
    transpose: Annotated[Literal["auto", "no", "yes"], Opt("exchange rows and columns of the grid; auto: detect it")] = "auto"
    half_turn: Annotated[
        Literal["auto", "no", "yes"],
        Opt(
            "exchange near and far: reverse both rows and columns; auto: as chosen for this scene before, else as its files say",
            live=True,
        ),
    ] = "auto"
    gamma: Annotated[
        float | Literal["auto"],
        Opt("screen value = stored value ** (1 / gamma), for pictures in linear light; 1 for none; auto: detect it", "", 0.1, 10),
    ] = "auto"
    force: Annotated[bool, Opt("open pictures even if they do not look like one light field")] = False
    cache_dir: Annotated[str, Opt("folder for packed scenes; empty: the user's cache directory", replays=False)] = ""


@attrs.frozen
class Governor:
    quality: Annotated[
        Literal["auto", "fixed"],
        Opt(
            "auto: lower quality level by level if the machine is too slow, and raise it when CPU is free; fixed: never",
            live=True,
            replays=False,
        ),
    ] = "auto"
    affinity: Annotated[
        str,
        Opt(
            "cores of each stage, as in track=1,render=0+2; auto: on two cores, tracking has one of its own; none: the system decides",
            replays=False,
        ),
    ] = "auto"
    nice: Annotated[
        str, Opt("niceness of each stage, as in render=0,track=5; empty: same as the parent process", replays=False)
    ] = ""


@attrs.frozen
class Replay:
    latency_ms: Annotated[
        float,
        Opt(
            "assumed latency from sensor to light if pictures do not depend on the clock: replay in steps, pace=max",
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
    replay: Replay = Replay()


def trusted(tree: Mapping[str, Any]) -> Config:
    """The inverse of `to_dict`, unchecked."""
    default = Config()
    return Config(**{name: type(getattr(default, name))(**values) for name, values in tree.items()})


def to_dict(config: Config) -> dict[str, Any]:
    """The tree as nested dicts of plain values, for messages and files."""
    return attrs.asdict(config)
