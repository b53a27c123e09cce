"""One frozen tree of typed values from TOML; every error names the key, the value and the remedy.

Layers, later ones win: the defaults below, the user's file, `--config`, `--set`. `Opt` carries what the type cannot:
unit, range, and whether a running session takes the change (`live`).
"""

import difflib
import functools
import os
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import attrs

from lfpipe.errors import UserError

if TYPE_CHECKING:  # at run time only where something is checked: a stage takes a tree that was, and starts sooner for it
    import cattrs


@attrs.frozen
class Opt:
    """What a value means and may be. low and high are inclusive; live: `lfpipe ctl set` may change it."""

    doc: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    live: bool = False


@attrs.frozen
class Camera:
    source: Annotated[str, Opt("camera:N, camera:/dev/videoN, file:PATH[?loop=0|1&pace=recorded|max|HZ] or demo; empty: the first camera found")] = ""
    width_px: Annotated[int, Opt("frame width asked of the camera; frames of another size are scaled", "px", 16, 7680)] = 640
    height_px: Annotated[int, Opt("frame height asked of the camera", "px", 16, 4320)] = 480
    rate_hz: Annotated[float, Opt("frame rate asked of the camera, and of a file without a rate of its own", "Hz", 0.1, 1000)] = 30.0
    format: Annotated[Literal["auto", "MJPG", "YUYV"], Opt("pixel format asked of the camera; auto: YUYV up to 640x480, MJPG above")] = "auto"
    focal_px: Annotated[float | Literal["auto"], Opt("focal length at width_px, as `lfpipe calibrate` finds it; auto: from fov_deg", "px", 1, 100000, live=True)] = "auto"
    fov_deg: Annotated[float, Opt("horizontal field of view, used while focal_px is auto", "deg", 5, 175, live=True)] = 56.0


@attrs.frozen
class Track:
    engine: Annotated[Literal["litert", "mediapipe"], Opt("litert: the landmark network in-thread; mediapipe: FaceMesh, as in the paper")] = "litert"
    filter: Annotated[Literal["predictive", "one-euro", "kalman", "mean"], Opt("smoothing of the eye positions; mean is the paper's", live=True)] = "predictive"
    mean_k: Annotated[int, Opt("frames in the moving average of filter = mean", "frames", 1, 1000, live=True)] = 5
    refine: Annotated[bool, Opt("refine the eye centres with the iris network, and learn the viewer's own distance between the eyes from the iris")] = False


@attrs.frozen
class Render:
    clock: Annotated[Literal["display", "camera"], Opt("display: a picture for every refresh, eyes predicted to it; camera: one picture per camera frame, as in the paper")] = "display"
    rate_hz: Annotated[float, Opt("refresh rate of the display clock", "Hz", 1, 1000)] = 60.0
    method: Annotated[Literal["auto", "nearest", "blend", "warp", "warp2"], Opt("how a view between the stored views is made; nearest is the paper's", live=True)] = "auto"
    alpha_px: Annotated[float | Literal["auto", "true"], Opt("camera pixels between neighbouring views of the grid; auto: from geometry and comfort; true: depth as in nature", "px", 1e-9, 1e9, live=True)] = "auto"
    anaglyph: Annotated[
        Literal["colour", "grey", "half-colour", "wimmer", "dubois", "dubois-green-magenta", "dubois-amber-blue", "mono", "side-by-side", "row-interleaved"],
        Opt("how the two eyes' views share one picture; colour is the paper's", live=True),
    ] = "dubois"
    light: Annotated[Literal["linear", "gamma"], Opt("where matrices with cross terms are applied: linear light, or code values", live=True)] = "linear"
    ghost_compensation: Annotated[float, Opt("how much of the light that leaks through the other eye's glass is taken out; nothing with dubois-amber-blue", "%", 0, 100, live=True)] = 0.0
    zero_plane_px: Annotated[float, Opt("disparity that lies in the plane of the screen", "px/view", -1000, 1000, live=True)] = 0.0
    extrapolate_views: Annotated[float, Opt("how far beyond the grid the viewpoint may go", "views", 0, 16, live=True)] = 2.0
    swap_eyes: Annotated[bool, Opt("exchange the eyes, for glasses worn or printed the other way round", live=True)] = False
    display_ms: Annotated[float, Opt("time from handing a picture to the display to light, added to the prediction", "ms", 0, 1000, live=True)] = 0.0


@attrs.frozen
class Screen:
    monitor: Annotated[int | str, Opt("monitor for the window and for the full screen: its number or a part of its name, as `lfpipe doctor` lists them; empty: wherever the window is")] = ""
    width_mm: Annotated[float | Literal["auto"], Opt("width of the picture on the screen; auto: as the monitor tells its size, 530 where it does not", "mm", 10, 20000, live=True)] = "auto"
    distance_mm: Annotated[float | Literal["auto"], Opt("viewer to screen; auto: from the distance between the eyes in the camera picture", "mm", 50, 50000, live=True)] = "auto"


@attrs.frozen
class Scene:
    layout: Annotated[str, Opt("name of the layout on disk; auto: found out (`lfpipe scene info`)")] = "auto"
    grid: Annotated[str, Opt("ROWSxCOLS where the files do not tell it; empty: found out")] = ""
    flip: Annotated[Literal["auto", "none", "rows", "cols", "both"], Opt("turn the order of the views; auto: found out")] = "auto"
    transpose: Annotated[Literal["auto", "no", "yes"], Opt("exchange rows and columns of the grid; auto: found out")] = "auto"
    gamma: Annotated[float | Literal["auto"], Opt("screen value = stored value ** (1 / gamma), for pictures in linear light; 1 for none; auto: found out", "", 0.1, 10)] = "auto"
    cache_dir: Annotated[str, Opt("where packed scenes are kept; empty: the user's cache directory")] = ""


@attrs.frozen
class Governor:
    quality: Annotated[Literal["auto", "fixed"], Opt("auto: where the machine is too slow, quality is lowered level by level, and raised when there is room; fixed: never", live=True)] = "auto"
    affinity: Annotated[str, Opt("cores of each stage, as in track=1,render=0+2; auto: on two cores tracking has one for itself; none: as the system will")] = "auto"
    nice: Annotated[str, Opt("niceness of each stage, as in render=0,track=5; empty: as this process's")] = ""


@attrs.frozen
class Control:
    bind: Annotated[str, Opt("where commands are taken besides the run directory: ipc for nowhere, or tcp://HOST:PORT, for clients whose keys are known")] = "ipc"
    keys: Annotated[str, Opt("folder of the keys (`lfpipe keys new`); empty: the user's")] = ""


@attrs.frozen
class Replay:
    latency_ms: Annotated[float, Opt("sensor to light, as the prediction takes it where pictures do not depend on the clock: replay in steps, pace=max", "ms", 0, 1000)] = 20.0


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
    return tuple(word for part in parts if not isinstance(part, type) for word in get_args(part))


def _wrong(value: object, kind: Any, opt: Opt) -> str | None:
    """Why value is not of kind and within opt, or None."""
    shape: Any = get_origin(kind)
    parts: tuple[Any, ...] = get_args(kind) if shape in (Union, UnionType) else (kind,)
    words = [word for part in parts if not isinstance(part, type) for word in get_args(part)]  # of its Literal
    if value in words and isinstance(value, str):
        return None
    number = float in parts or int in parts
    if number and isinstance(value, int | float) and not isinstance(value, bool):
        if int in parts and not isinstance(value, int):
            return f"{value!r} is not a whole number"
        low, high = opt.low, opt.high
        if value != value or (low is not None and value < low) or (high is not None and value > high):
            return f"{value!r} is out of range: {low:g} to {high:g} {opt.unit}".rstrip()
        return None
    if (bool in parts and isinstance(value, bool)) or (str in parts and isinstance(value, str)):
        return None
    if words and not number:
        close = difflib.get_close_matches(str(value), words, 1, 0.5)
        return f"{value!r} is not one of {', '.join(words)}" + (f" (did you mean {close[0]!r}?)" if close else "")
    wanted = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}
    names = [wanted[part] for part in parts if part in wanted] + [repr(word) for word in words]
    return f"{value!r} is not {' or '.join(names)}"


@functools.cache
def _converter() -> "cattrs.Converter":
    import cattrs

    converter = cattrs.Converter(forbid_extra_keys=True)

    def is_annotated(hint: Any) -> bool:
        shape: Any = get_origin(hint)
        return shape is Annotated

    def annotated(hint: Any) -> Any:
        kind, opt = get_args(hint)

        def structure(value: object, _: Any) -> Any:
            if problem := _wrong(value, kind, opt):
                raise ValueError(problem)
            whole = float in (kind, *get_args(kind)) and isinstance(value, int) and not isinstance(value, bool)
            return float(value) if whole and isinstance(value, int) else value

        return structure

    converter.register_structure_hook_factory(is_annotated, annotated)
    return converter


def _problems(error: BaseException, path: str) -> Iterable[str]:
    """The leaves of a cattrs error as `key: what is wrong` lines."""
    from cattrs.errors import ClassValidationError, ForbiddenExtraKeysError

    if isinstance(error, ClassValidationError):
        named, rest = error.group_exceptions()
        for inner, note in named:
            yield from _problems(inner, f"{path}.{note.name}" if path else note.name)
        for inner in rest:
            yield from _problems(inner, path)
    elif isinstance(error, ForbiddenExtraKeysError):
        for name in sorted(error.extra_fields):
            key = f"{path}.{name}" if path else name
            known = list(options()) if path else [*options(), *(section.name for section in attrs.fields(Config))]
            close = difflib.get_close_matches(key, known, 1, 0.6)
            yield f"{key}: unknown key" + (f", did you mean {close[0]!r}?" if close else "")
    else:
        yield f"{path}: {error}" if isinstance(error, ValueError) else f"{path}: a table is needed here ([{path}])"


def from_dict(tree: Mapping[str, Any]) -> Config:
    """A checked Config from nested dicts; missing keys take their defaults.

    Raises UserError that lists every wrong key at once.
    """
    from cattrs.errors import ClassValidationError, ForbiddenExtraKeysError

    try:
        return _converter().structure(tree, Config)
    except (ClassValidationError, ForbiddenExtraKeysError) as error:
        raise UserError(
            "configuration: " + "\n  ".join(_problems(error, "")),
            "`lfpipe config show` lists every key with its unit and range",
        ) from None


def trusted(tree: Mapping[str, Any]) -> Config:
    """The Config that `to_dict` made tree of, unchecked."""
    default = Config()
    return Config(**{name: type(getattr(default, name))(**values) for name, values in tree.items()})


def to_dict(config: Config) -> dict[str, Any]:
    """The tree as nested dicts of plain values, as messages and files carry it."""
    return attrs.asdict(config)


def parse_set(text: str) -> tuple[str, Any]:
    """`KEY=VALUE` as (dotted key, value); the value is read as TOML, a bare word as a string.

    Raises UserError where there is no `=` or no key.
    """
    key, sign, raw = text.partition("=")
    if not sign or not key.strip():
        raise UserError(f"{text!r} is not KEY=VALUE", "for example render.method=warp")
    try:
        value = tomllib.loads(f"v = {raw}")["v"]
    except tomllib.TOMLDecodeError:
        value = raw.strip()
    if isinstance(value, bool) and options().get(key.strip(), (bool,))[0] is not bool:
        value = raw.strip()  # a word, as in render.alpha_px=true
    return key.strip(), value


def merged(tree: Mapping[str, Any], sets: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """tree with dotted keys put in; the result is unchecked (`from_dict` checks it)."""
    out: dict[str, Any] = {k: dict(v) if isinstance(v, Mapping) else v for k, v in tree.items()}
    for key, value in sets:
        section, _, name = key.partition(".")
        table = out.setdefault(section, {})
        if name and isinstance(table, dict):
            table[name] = value
        else:
            out[section] = value
    return out


def updated(config: Config, sets: Mapping[str, Any], live_only: bool = False) -> Config:
    """config with dotted keys changed, checked whole.

    live_only: refuse keys that a running session cannot take. Raises UserError; config itself never changes.
    """
    new = from_dict(merged(to_dict(config), sets.items()))
    if live_only:
        known = options()
        fixed = [key for key in sets if not known[key][1].live]
        if fixed:
            raise UserError(f"{', '.join(fixed)}: fixed while a session runs", "stop it and give the key to `lfpipe up --set`")
    return new


def user_file() -> Path:
    """Where the user's own settings are kept; need not exist."""
    import platformdirs

    return Path(platformdirs.user_config_dir("lfpipe")) / "config.toml"


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text())
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: not TOML: {error}", "`lfpipe config init` writes a complete file to start from") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}", "check the path and its permissions") from None


def presets() -> list[str]:
    """Names that `--config` takes besides files."""
    return sorted(path.stem for path in (Path(__file__).parent / "presets").glob("*.toml"))


def load(file: str | os.PathLike[str] | None = None, sets: Iterable[str] = ()) -> Config:
    """The checked tree from the user's file, `--config` (a path or a preset's name) and `--set` texts.

    Raises UserError that names each wrong key, value and remedy.
    """
    layers: list[dict[str, Any]] = []
    if user_file().is_file():
        layers.append(_read(user_file()))
    if file is not None:
        preset = Path(__file__).parent / "presets" / f"{file}.toml"
        if not Path(file).is_file() and not preset.is_file():
            raise UserError(f"--config {file}: no such file or preset", f"a TOML file, or one of: {', '.join(presets())}")
        layers.append(_read(Path(file) if Path(file).is_file() else preset))
    tree: dict[str, Any] = {}
    for layer in layers:
        flat = [(f"{s}.{k}", v) for s, t in layer.items() if isinstance(t, dict) for k, v in t.items()]
        tree = merged(tree, flat)
        tree.update({k: v for k, v in layer.items() if not isinstance(v, dict)})
    return from_dict(merged(tree, [parse_set(text) for text in sets]))
