"""Every configuration key with its type, default and meaning."""

import functools
import math
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

import attrs

AUTO_HZ = 60.0  # pictures per second without a screen

PixelFormat = Literal["auto", "MJPG", "YUYV", "UYVY", "NV12", "YU12", "BGR3", "RGB3", "GREY"]
Method = Literal["auto", "nearest", "blend", "warp", "warp2"]
Flip = Literal["auto", "none", "rows", "cols", "both"]
Decision = Literal["auto", "no", "yes"]
Anaglyph = Literal[
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
]


# The built-in filters: value of track.filter -> module of `lfpipe.track.filters` whose function
# `make(track, device_latency_s)` returns it.
FILTER_MODULES = {
    "predictive": "imm",
    "one-euro": "one_euro",
    "mean": "mean",
}


@attrs.frozen
class Key:
    """Meaning and limits of a key."""

    default: Any
    doc: str
    """The meaning, in one line."""
    unit: str
    low: float
    """Inclusive minimum of a number; -inf for none."""
    high: float
    """Inclusive maximum of a number; inf for none."""
    live: bool
    """Whether `lfpipe ctl set` may change it; its stage then rereads `context.config`."""
    replays: bool
    """Whether it can change the results of a replay."""
    types: tuple[type, ...] = ()
    """Its types, of int, float, str and bool."""
    words: tuple[str | int, ...] = ()
    """Words and numbers that it accepts in addition."""


def key(
    default: Any,
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    *,
    doc: str,
    live: bool = False,
    replays: bool = True,
    words: tuple[str, ...] = (),
) -> Any:
    """A key as a field of its section.

    words: the values of a text; default: those of its type.
    """
    made = Key(default, doc, unit, low, high, live, replays, words=words)
    return attrs.field(default=default, metadata={"key": made})


@attrs.frozen(kw_only=True)
class Camera:
    source: str = key(
        "",
        replays=False,
        doc=(
            "camera:N, camera:/dev/videoN, camera:NAME, file:PATH[?loop=0|1&pace=recorded|max|HZ]"
            " or demo; empty: the first camera"
        ),
    )
    width_px: int = key(
        640,
        "px",
        16,
        7680,
        doc=(
            "requested frame width; frames of another size are scaled, with black bars if the"
            " aspect ratio differs"
        ),
    )
    height_px: int = key(480, "px", 16, 4320, doc="requested frame height")
    rate_hz: float | Literal["auto"] = key(
        "auto",
        "Hz",
        0.1,
        1000,
        doc=(
            "requested frame rate, and the rate of files without one; auto: 30, or 60 if the camera"
            " supports it in the same format, on more than two cores with track.engine litert"
        ),
    )
    format: PixelFormat = key(
        "auto",
        replays=False,
        doc=(
            "requested pixel format; auto: the format that reaches the size, then the rate, then"
            " the cheapest to decode"
        ),
    )
    exposure: float | Literal["auto"] = key(
        "auto", "ms", 0.01, 1000, doc="exposure time; auto: set by the camera"
    )
    gain: float | Literal["auto"] = key(
        "auto", "", 0, 65535, doc="gain in units of the camera; auto: set by the camera"
    )
    dynamic_framerate: Literal["off", "on", "auto"] = key(
        "off",
        doc="lower the rate in dim light; auto: the camera's setting",
    )
    rotate: Literal[0, 90, 180, 270] = key(0, "deg", doc="clockwise rotation of the camera picture")
    mirror: bool = key(False, doc="mirror the camera picture, after rotation")
    above_mm: float = key(
        0.0,
        "mm",
        -2000,
        2000,
        live=True,
        doc="height of the camera above the middle of the picture",
    )
    tilt_deg: float = key(0.0, "deg", -60, 60, live=True, doc="downward tilt of the camera")
    focal_px: float | Literal["auto"] = key(
        "auto",
        "px",
        1,
        100000,
        live=True,
        doc="focal length at width_px; auto: as measured by `lfpipe calibrate`, else from fov_deg",
    )
    fov_deg: float = key(
        56.0,
        "deg",
        5,
        175,
        live=True,
        doc="horizontal field of view, used if focal_px is auto and not measured",
    )

    @property
    def frame_px(self) -> tuple[int, int]:
        """(width, height) of a frame after rotation."""
        upright = self.rotate % 180 == 0
        return (self.width_px, self.height_px) if upright else (self.height_px, self.width_px)

    @property
    def nominal_hz(self) -> float:
        """rate_hz of a source without a rate."""
        return 30.0 if isinstance(self.rate_hz, str) else self.rate_hz

    @property
    def highest_hz(self) -> float:
        """rate_hz of a camera that supports it."""
        return 60.0 if isinstance(self.rate_hz, str) else self.rate_hz


@attrs.frozen
class Track:
    engine: Literal["litert", "mediapipe"] = key(
        "litert", doc="litert: the landmark network in-thread; mediapipe: FaceMesh, as in the paper"
    )
    filter: str = key(
        "predictive",
        live=True,
        words=tuple(FILTER_MODULES),
        doc="filter of the eye positions; mean is the paper's",
    )
    mean_k: int = key(5, "frames", 1, 1000, live=True, doc="frames averaged by filter = mean")


@attrs.frozen(kw_only=True)
class Render:
    clock: Literal["display", "camera"] = key(
        "display",
        replays=False,
        doc=(
            "display: one picture per refresh, with predicted eyes; camera: one picture per camera"
            " frame, as in the paper"
        ),
    )
    rate_hz: float | Literal["auto"] = key(
        "auto",
        "Hz",
        1,
        1000,
        replays=False,
        doc=(
            "pictures per second of the display clock; auto: every refresh, or 60 without a screen"
        ),
    )
    method: Method = key(
        "auto", live=True, doc="synthesis of views between the stored ones; nearest is the paper's"
    )
    device: Literal["auto", "cpu", "gpu"] = key(
        "auto",
        doc=(
            "what draws a session's warped pictures; gpu needs the extra gpu; auto: a GPU that"
            " is hardware, except in a replay, whose pictures are the same everywhere"
        ),
    )
    alpha_px: float | Literal["auto"] = key(
        "auto",
        "px",
        1e-09,
        1e09,
        live=True,
        doc=("camera pixels between neighbouring views; auto: from geometry, comfort and depth"),
    )
    depth: float = key(
        0.0,
        "",
        0,
        1,
        live=True,
        doc=(
            "depth with alpha_px auto: 0 comfortable, 1 true, or the whole grid if true depth is"
            " unknown"
        ),
    )
    anaglyph: Anaglyph = key(
        "dubois", live=True, doc="how both views share one picture; colour is the paper's"
    )
    light: Literal["linear", "gamma"] = key(
        "linear",
        live=True,
        doc="domain of matrices with cross terms: linear light or code values",
    )
    ghost_compensation: float = key(
        0.0,
        "%",
        0,
        100,
        live=True,
        doc=("share of the crosstalk that is subtracted; no effect with dubois-amber-blue"),
    )
    zero_plane_px: float | Literal["auto"] = key(
        "auto",
        "px/view",
        -1000,
        1000,
        live=True,
        doc=(
            "disparity of points at the screen; auto: that of the nearest points at the left and"
            " right border"
        ),
    )
    extrapolate_views: float = key(
        2.0, "views", 0, 16, live=True, doc="extrapolation beyond the grid"
    )
    keep_depth: bool = key(
        True,
        live=True,
        doc=(
            "at the grid edge: true clamps the midpoint and keeps the eye distance; false clamps"
            " each eye, as in the paper"
        ),
    )
    swap_eyes: bool = key(False, live=True, doc="swap the eyes, for reversed glasses")
    device_latency_ms: float = key(
        0.0,
        "ms",
        0,
        1000,
        live=True,
        replays=False,
        doc=(
            "delay of the camera before its stamp plus delay of the display after presentation;"
            " used by prediction and measured by `lfpipe calibrate --latency`"
        ),
    )
    device_latency_measured: str = key(
        "",
        replays=False,
        doc="date, camera and monitor of the measurement of device_latency_ms; empty: none",
    )

    @property
    def nominal_hz(self) -> float:
        """rate_hz as a number; AUTO_HZ if the screen decides."""
        return AUTO_HZ if isinstance(self.rate_hz, str) else self.rate_hz


@attrs.frozen
class Screen:
    monitor: int | str = key(
        "",
        "",
        0,
        63,
        replays=False,
        doc=(
            "monitor of the window: its number or part of its name, from `lfpipe doctor -v`;"
            " empty: the window's own"
        ),
    )
    width_mm: float | Literal["auto"] = key(
        "auto",
        "mm",
        10,
        20000,
        live=True,
        doc=(
            "width of the picture on the screen; auto: from the size of the monitor, 530 if unknown"
        ),
    )
    distance_mm: float | Literal["auto"] = key(
        "auto",
        "mm",
        50,
        50000,
        live=True,
        doc="viewer to screen; auto: from the eye distance in the camera picture",
    )
    eyes_mm: float = key(
        63.0, "mm", 40, 80, live=True, doc="your eye distance; 63 is the mean of adults"
    )


@attrs.frozen(kw_only=True)
class Scene:
    layout: str = key("auto", doc="layout on disk; auto: detect it (see `lfpipe scene info`)")
    grid: str = key("", doc="ROWSxCOLS; empty: detect it")
    flip: Flip = key("auto", doc="reverse the order of the views; auto: detect it")
    transpose: Decision = key("auto", doc="swap rows and columns of the grid; auto: detect it")
    invert_depth: Decision = key(
        "auto",
        live=True,
        doc=(
            "reverse rows and columns, which swaps near and far; auto: the last choice for this"
            " scene, else as its files say"
        ),
    )
    gamma: float | Literal["auto"] = key(
        "auto",
        "",
        0.1,
        10,
        doc=(
            "screen value = stored value ** (1 / gamma), for linear pictures; 1 for none; auto:"
            " detect it"
        ),
    )
    cache_dir: str = key("", replays=False, doc="folder for packs; empty: your cache directory")


@attrs.frozen
class Governor:
    quality: Literal["auto", "fixed"] = key(
        "auto",
        live=True,
        replays=False,
        doc=("auto: lower the quality level while the CPU is overloaded; fixed: never"),
    )


@attrs.frozen
class Replay:
    latency_ms: float = key(
        20.0,
        "ms",
        0,
        1000,
        doc=("assumed latency from sensor to display in a replay in steps or with pace=max"),
    )


@attrs.frozen(kw_only=True)
class Config:
    """The whole tree. Immutable: `updated` returns a new tree."""

    camera: Camera = Camera()
    track: Track = Track()
    render: Render = Render()
    screen: Screen = Screen()
    scene: Scene = Scene()
    governor: Governor = Governor()
    replay: Replay = Replay()


SECTIONS: dict[str, Any] = {section.name: section.type for section in attrs.fields(Config)}


@functools.cache
def options() -> dict[str, Key]:
    """Every key by its dotted name, in the order of the tree."""
    keys = {}
    for section, kind in SECTIONS.items():
        for field in attrs.fields(kind):
            parts = (
                get_args(field.type)
                if get_origin(field.type) in (Union, UnionType)
                else (field.type,)
            )
            one: Key = field.metadata["key"]
            if not one.words:
                types = tuple(part for part in parts if isinstance(part, type))
                words = tuple(
                    word for part in parts if part not in types for word in get_args(part)
                )
                one = attrs.evolve(one, types=types, words=words)
            keys[f"{section}.{field.name}"] = one
    return keys


def choices(name: str) -> tuple[str, ...]:
    """The words that a key accepts, in their order."""
    return tuple(word for word in options()[name].words if isinstance(word, str))
