"""Measured focal lengths, in a file next to the user's settings: `[NAME] focal_px, width_px`, one table per camera."""

import math
from pathlib import Path

import attrs

from lfpipe.config.layers import FILE_BYTES, user_file
from lfpipe.config.tree import Config
from lfpipe.errors import UserError
from lfpipe.files.safe_files import read_text
from lfpipe.files.untrusted import toml_table
from lfpipe.host.files import is_missing


def camera_file() -> Path:
    """Path of that file, which need not exist."""
    return user_file().with_name("cameras.toml")


def with_measured_focal(config: Config, camera: str) -> Config:
    """Returns config with the measured focal length of that camera, unless camera.focal_px has a value. Without a
    measurement, config is unchanged. Raises UserError if the file is damaged."""
    path = camera_file()
    if config.camera.focal_px != "auto" or is_missing(path):
        return config
    remedy = "remove the file, and run `lfpipe calibrate` again"
    table = toml_table(read_text(path, FILE_BYTES, str(path), remedy), str(path), remedy).get(camera)
    if table is None:
        return config
    found = [table.get(key) if isinstance(table, dict) else None for key in ("focal_px", "width_px")]
    focal_px, width_px = (float(each) if isinstance(each, int | float) and math.isfinite(each) else 0.0 for each in found)
    if focal_px < 1 or width_px < 1:
        raise UserError(f"{path}: [{camera}]: focal_px and width_px must both be numbers of at least 1", remedy)
    here_px = round(focal_px * config.camera.frame_px[0] / width_px, 1)
    return attrs.evolve(config, camera=attrs.evolve(config.camera, focal_px=here_px))
