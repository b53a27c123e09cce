"""Checks values from outside against the tree, and merges them: defaults, the user's file,
`--config`, `--set`; later ones win. And writes the user's files: settings with every key explained,
or written key by key, and measured cameras.

All problems are reported at once, each with its key, value and remedy. Values may have any type and
depth that TOML, msgpack or a caller can carry. The only exception raised is UserError.
"""

import difflib
import itertools
import json
import math
import os
import tomllib
import unicodedata
from collections.abc import Iterable, Mapping, MutableMapping
from pathlib import Path
from typing import Any

import attrs

from lfpipe.config.session_options import Placement
from lfpipe.config.tree import SECTIONS, Config, Key, options
from lfpipe.errors import UserError, quoted
from lfpipe.eyes import MAX_EYE_PX
from lfpipe.files.safe_files import LINE_CHARS, Fields, read_text, toml_table, write_file
from lfpipe.host.files import exists, is_missing
from lfpipe.plugins import ENGINES, FILTERS, plugins

# values of --config
PRESETS = {path.stem: path for path in (Path(__file__).parent / "presets").glob("*.toml")}
FILE_FORM = (
    "correct that file (`lfpipe config init FILE` writes a complete one), or name a preset:"
    f" {', '.join(PRESETS)}"
)
SHOW = "see every key with its unit and range: `lfpipe config show`"
MAX_LISTED = 10  # problems that one message names
NAMES = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}
# keys whose values other packages may add
PLUGGABLE = {"track.engine": ENGINES, "track.filter": FILTERS}


def _problem(name: object, value: object) -> str:
    """`key: problem`; "" if the key takes this value."""
    if not isinstance(name, str):
        return f"{quoted(name)}: unknown key"
    if name in options():
        key = options()[name]
        if name in PLUGGABLE:
            key = attrs.evolve(key, words=(*key.words, *plugins(PLUGGABLE[name])))
        why = _wrong(value, key)
        return why and f"{name}: {why}"
    if name in SECTIONS:
        first = next(key for key in options() if key.startswith(f"{name}."))
        return (
            f"{name}: a section, which cannot have the value {quoted(value)}; its keys are"
            f" {first}, ..."
        )
    section = name.partition(".")[0]
    name = name if section in SECTIONS else section
    close = closest(name, [*options(), *SECTIONS])
    return f"{name if len(name) < 40 else quoted(name)}: unknown key" + (
        f", did you mean {close!r}?" if close else ""
    )


def _wrong(value: object, key: Key) -> str:
    """Why a key cannot have this value, or ""."""
    if any(type(value) is type(word) and value == word for word in key.words) or (
        isinstance(value, bool) and bool in key.types
    ):
        return ""
    if (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and (float in key.types or int in key.types)
    ):
        if int in key.types and not isinstance(value, int):
            return f"{quoted(value)} is not a whole number"
        inside = key.low <= value <= key.high  # false for nan
        return (
            ""
            if inside
            else f"{quoted(value)} is out of range: {key.low:g} to {key.high:g} {key.unit}".rstrip()
        )
    if isinstance(value, str) and str in key.types:
        return wrong_text(value)
    if key.types:
        return (
            f"{quoted(value)} is not"
            f" {' or '.join([*(NAMES[kind] for kind in key.types), *map(repr, key.words)])}"
        )
    texts = [str(word) for word in key.words]
    close = closest(value, texts, 0.5)
    return f"{quoted(value)} is not one of {', '.join(texts)}" + (
        f" (did you mean {close!r}?)" if close else ""
    )


def wrong_text(value: str) -> str:
    """Why a text is refused, or "".

    Texts are paths and names: they must survive a message, a file and a system call.
    """
    if len(value) > LINE_CHARS:
        return f"{quoted(value)} has {len(value)} characters; at most {LINE_CHARS} are allowed"
    odd = next((c for c in value if unicodedata.category(c) in ("Cc", "Cs")), "")
    return f"{quoted(value)} contains {odd!a}, which is not allowed in text" if odd else ""


def closest(value: object, texts: Iterable[str], cutoff: float = 0.6) -> str:
    """The closest of texts to value, a likely typing error; "" without one."""
    close = (
        difflib.get_close_matches(value, list(texts), 1, cutoff)
        if isinstance(value, str) and len(value) < 40
        else []
    )
    return close[0] if close else ""


def problems(values: Iterable[tuple[object, object]]) -> list[str]:
    """The problems of (dotted key, value) pairs: the first MAX_LISTED, and whether there
    are more.
    """
    wrong = list(
        itertools.islice(filter(None, itertools.starmap(_problem, values)), MAX_LISTED + 1)
    )
    return [*wrong[:MAX_LISTED], "and more"] if len(wrong) > MAX_LISTED else wrong


def refusal(wrong: list[str], remedy: str = SHOW) -> UserError:
    """All problems as one UserError."""
    return UserError("configuration: " + "\n  ".join(wrong), remedy)


def flat(tree: Mapping[Any, Any]) -> list[tuple[object, object]]:
    """(dotted key, value) pairs of nested tables.

    A value that is not a table keeps its own name.
    """
    pairs: list[tuple[object, object]] = []
    for section, table in tree.items():
        if isinstance(section, str) and section in SECTIONS and isinstance(table, Mapping):
            pairs += [
                (f"{section}.{key}" if isinstance(key, str) else key, value)
                for key, value in table.items()
            ]
        else:
            pairs.append((section, table))
    return pairs


def changed(config: Config, values: Mapping[str, Any]) -> Config:
    """Returns config with dotted keys changed; `problems` must have accepted them."""
    sections: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        section, _, name = key.partition(".")
        number = (
            isinstance(value, int) and not isinstance(value, bool) and float in options()[key].types
        )
        sections.setdefault(section, {})[name] = float(value) if number else value
    changes = {
        section: attrs.evolve(getattr(config, section), **fields)
        for section, fields in sections.items()
    }
    return attrs.evolve(config, **changes)


def updated(config: Config, sets: Mapping[str, Any], live_only: bool = False) -> Config:
    """Returns config with dotted keys changed: all of them, or none if one is refused.

    live_only: refuse keys that cannot change while a session runs. Raises UserError; config itself
    never changes.
    """
    if wrong := problems(sets.items()):
        raise refusal(wrong)
    if fixed := [key for key in sets if live_only and not options()[key].live]:
        raise UserError(
            f"{', '.join(fixed)}: fixed while a session runs",
            "stop it and give the key to `lfpipe up --set`",
        )
    return changed(config, sets)


def parse_set(text: str) -> tuple[str, bool | int | float | str]:
    """Parses `KEY=VALUE` to (dotted key, value). The value is a number, boolean or string in TOML
    syntax; anything else is plain text. `updated` checks the key and its value.

    Raises UserError if `=` or the key is missing, or if a character is not allowed.
    """
    key, sign, raw = (word.strip() for word in text.partition("="))
    if not sign or not key:
        raise UserError(f"{quoted(text)} is not KEY=VALUE", "use for example render.method=warp")
    value: object = raw
    try:
        table = tomllib.loads(f"v = {raw}")
        value = table["v"] if len(table) == 1 else raw
    except (ValueError, RecursionError):  # a bare word, or endless digits or brackets
        pass
    if isinstance(value, int) and value.bit_length() > 63:
        # out of every range, and too large for a message
        value = math.inf if value > 0 else -math.inf
    if not isinstance(value, bool | int | float | str):
        value = raw
    for word in (key, value):
        if isinstance(word, str) and (why := wrong_text(word)):
            raise UserError(f"{quoted(key)}: {why}", SHOW)
    return key, value


def load(file: str | os.PathLike[str] | None = None, sets: Iterable[str] = ()) -> Config:
    """The checked tree from the user's file, `--config` (a path or a preset's name) and `--set`
    texts.

    Raises UserError with each wrong file, key, value and remedy.
    """
    values: dict[str, Any] = {}
    wrong = []
    remedy = SHOW
    files = {str(user_file()): user_file()} if not is_missing(user_file()) else {}
    if file is not None:
        name = os.fspath(file)
        files[f"--config {name}"] = (
            PRESETS[name] if name in PRESETS and is_missing(name) else Path(name)
        )
    for name, path in files.items():
        try:
            pairs = flat(toml_table(read_text(path, name, FILE_FORM), name, FILE_FORM))
        except UserError as error:
            wrong.append(error.message)
            remedy = FILE_FORM
            continue
        if in_file := [f"{name}: {problem}" for problem in problems(pairs)]:
            wrong += in_file
            remedy = FILE_FORM  # `config show` reads the same file
        values |= {str(key): value for key, value in pairs}
    for text in sets:
        try:
            key, value = parse_set(text)
        except UserError as error:
            wrong.append(error.message)
            continue
        wrong += problems([(key, value)])
        values[key] = value
    if wrong:
        raise refusal(wrong, remedy)
    return changed(Config(), values)


PLACED = "live:"  # prefix of the table of a placement
USUAL_DEG = 30, 130  # fields of view of webcams, narrow to wide


def user_file() -> Path:
    """Path of the user's own settings, which need not exist."""
    import platformdirs

    return Path(platformdirs.user_config_dir("lfpipe")) / "config.toml"


def camera_file() -> Path:
    """Path of the measured focal lengths, which need not exist: `[NAME] focal_px, width_px`, one
    table per camera; and of the placement of two cameras, `["live:NAMES"]`.
    """
    return user_file().with_name("cameras.toml")


def _measured(name: str) -> Fields | None:
    """The table of a camera among the measured ones. Raises UserError if the file is damaged."""
    path = camera_file()
    if is_missing(path):
        return None
    remedy = "remove the file, and run `lfpipe calibrate` again"
    cameras = toml_table(read_text(path, str(path), remedy), str(path), remedy)
    return Fields(cameras, str(path), remedy).table(name) if name in cameras else None


def measured_placement(cameras: str, width_px: int) -> Placement | None:
    """The measured placement of two cameras whose views have that width. Raises UserError if the
    file is damaged.
    """
    if (measured := _measured(PLACED + cameras)) is None:
        return None
    height_px = measured.number("height_px", -MAX_EYE_PX, MAX_EYE_PX)
    return Placement(
        height_px=height_px * width_px / measured.number("width_px", 1, MAX_EYE_PX),
        rotation_deg=measured.number("rotation_deg", -45, 45),
        scale=measured.number("scale", 0.5, 2),
        swapped=measured.flag("swapped"),
    )


def with_measured_focal(config: Config, camera: str) -> Config:
    """Returns config with the measured focal length of that camera, unless camera.focal_px has a
    value. Without a measurement, config is unchanged. Raises UserError if the file is damaged.
    """
    if config.camera.focal_px != "auto" or (measured := _measured(camera)) is None:
        return config
    focal_px, width_px = (measured.number(name, 1, MAX_EYE_PX) for name in ("focal_px", "width_px"))
    here_px = round(focal_px * config.camera.frame_px[0] / width_px, 1)
    return attrs.evolve(config, camera=attrs.evolve(config.camera, focal_px=here_px))


def has_key(section: str, name: str) -> bool:
    """Whether the user's own settings, which `load` has accepted, set [section] name."""
    path = user_file()
    return not is_missing(path) and name in tomllib.loads(path.read_text("utf-8")).get(section, {})


def write_keys(path: Path, section: str, values: Mapping[str, float | bool | str | None]) -> None:
    """Sets keys of [section] in the TOML file at path, or removes those whose value is None. Keeps
    everything else, comments and order too. The write is atomic.

    Raises UserError if it cannot be written, is not TOML, or section is not a table.
    """
    import tomlkit

    try:
        tree = tomlkit.parse(path.read_text() if exists(path) else "")
        table = tree.setdefault(section, tomlkit.table())
        if not isinstance(table, MutableMapping):
            raise ValueError(f"{section} is not a table")
        for name, value in values.items():
            if value is None:
                table.pop(name, None)
            else:
                table[name] = value
        write_file(path, tomlkit.dumps(tree).encode(), 0o644)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise UserError(
            f"{path}: {', '.join(values)} not saved: {why}",
            "make that file writable; if it is damaged, correct it or remove it",
        ) from None


def keep_focal(camera: str, focal_px: float, width_px: int) -> None:
    """Stores the measured focal length of a camera, and removes one from the user's settings, which
    would override it. Raises UserError if no webcam has its field of view: the distance was wrong;
    and as `write_keys`.
    """
    fov_deg = math.degrees(2 * math.atan(width_px / 2 / focal_px))
    if not USUAL_DEG[0] <= fov_deg <= USUAL_DEG[1]:
        raise UserError(
            f"a field of view of {fov_deg:.1f} degrees is not stored: webcams have {USUAL_DEG[0]}"
            f" to {USUAL_DEG[1]} degrees",
            "measure the distance, and try again; if the lens really has this field of view, set"
            f" focal_px = {focal_px} under [camera] in {user_file()}",
        )
    write_keys(camera_file(), camera, {"focal_px": focal_px, "width_px": width_px})
    if has_key("camera", "focal_px"):
        write_keys(user_file(), "camera", {"focal_px": None})


def _range(key: Key) -> str:
    limits = f"{key.low:g} to {key.high:g}" if math.isfinite(key.low) else ""
    accepted = " or ".join(
        filter(None, (f"{limits} {key.unit}".strip(), ", ".join(map(str, key.words))))
    )
    return f" [{accepted}]" if accepted else ""


def _toml(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)  # TOML allows no surrogate pairs


def commented(config: Config | None = None) -> str:
    """TOML text of config (the defaults when None) for people: above each key its meaning, unit and
    range.
    """
    lines = ["# Every key of lfpipe. `--set SECTION.KEY=VALUE` changes one for one run."]
    for section, values in attrs.asdict(config or Config()).items():
        lines += ["", f"[{section}]"]
        for name, value in values.items():
            key = options()[f"{section}.{name}"]
            live = "; `lfpipe ctl set` changes it live" if key.live else ""
            was = "" if value == key.default else f"; default {_toml(key.default)}"
            lines += [f"# {key.doc}{_range(key)}{live}{was}", f"{name} = {_toml(value)}"]
    return "\n".join(lines) + "\n"
