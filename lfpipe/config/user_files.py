"""The user's own files: settings with every key explained, or written key by key, and measured
cameras.
"""

import json
import math
import tomllib
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

import attrs

from lfpipe.config.session_options import Placement
from lfpipe.config.tree import Config, Key, options
from lfpipe.errors import UserError
from lfpipe.eyes import MAX_EYE_PX
from lfpipe.files.safe_files import read_text, write_file
from lfpipe.files.untrusted import Fields, toml_table
from lfpipe.host.files import exists, is_missing

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


def check_focal(focal_px: float, width_px: int) -> float:
    """The field of view in degrees of a measured focal length. Raises UserError if no webcam has
    it: the distance was wrong.
    """
    fov_deg = math.degrees(2 * math.atan(width_px / 2 / focal_px))
    if not USUAL_DEG[0] <= fov_deg <= USUAL_DEG[1]:
        raise UserError(
            f"a field of view of {fov_deg:.1f} degrees is not stored: webcams have {USUAL_DEG[0]}"
            f" to {USUAL_DEG[1]} degrees",
            "measure the distance, and try again; if the lens really has this field of view, set"
            f" focal_px = {focal_px} under [camera] in {user_file()}",
        )
    return fov_deg


def keep_focal(camera: str, focal_px: float, width_px: int) -> bool:
    """Stores the measured focal length of a camera. Returns whether one was removed from the user's
    settings, which would override it. Raises UserError as `write_keys`.
    """
    write_keys(camera_file(), camera, {"focal_px": focal_px, "width_px": width_px})
    if overridden := has_key("camera", "focal_px"):
        write_keys(user_file(), "camera", {"focal_px": None})
    return overridden


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
