"""The HCI 4D benchmark: input_Cam000.png ... row by row, parameters.cfg and true disparity where given.

Format: https://lightfield-analysis.uni-konstanz.de (Honauer, Johannsen, Kondermann, Goldluecke, ACCV 2016).
"""

import configparser
import math
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.untrusted import in_range
from lfpipe.scene.files import Listing, read_bytes, read_pfm
from lfpipe.scene.layouts._grid import MAX_SIDE, files_source, parse_grid, require_whole
from lfpipe.scene.layouts._views import describe_views
from lfpipe.scene.lightfield import Geometry
from lfpipe.scene.source import SceneSource, Turn

NAME = "hci"
_VIEW = re.compile(r"input_Cam(\d{3,5})\.(?:png|jpe?g|ppm)", re.IGNORECASE)
_TRUTH = re.compile(r"gt_disp_lowres(?:_Cam(\d{3,5}))?\.pfm", re.IGNORECASE)

_CONVENTION = "the HCI layout is row by row from the top left camera"
_NOT_NEEDED = "correct it or move the file away, it is not needed"


def detect(listing: Listing) -> int | None:
    return 90 if not listing.is_file and any(_VIEW.fullmatch(name) for name in listing.names) else None


def _parameters(path: Path) -> configparser.SectionProxy:
    """All sections of parameters.cfg in one table; keys vary from scene to scene. Raises UserError."""
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        parser.read_string(read_bytes(path).decode("utf-8", "replace"))
    except configparser.Error as error:
        reason = str(error).splitlines()[0]
        raise UserError(f"{path}: not a valid parameters.cfg: {reason}", _NOT_NEEDED) from None
    whole = configparser.ConfigParser(interpolation=None)
    whole.read_dict({"all": {key: value for section in parser.sections() for key, value in parser[section].items()}})
    return whole["all"]


def _number(path: Path, table: configparser.SectionProxy, key: str, low: float, high: float) -> float | None:
    """The number at key; None if it is missing, or zero or text for "not known". Raises UserError if it is out of range."""
    try:
        value = float(table.get(key, "0"))
    except ValueError:
        return None
    return in_range(value, low, high, f"{path}: {key}", _NOT_NEEDED) if value else None


def _geometry(path: Path, table: configparser.SectionProxy) -> Geometry:
    """Baseline and focus distance in mm; the focal length in px of the longer side of a view."""
    focal, sensor = _number(path, table, "focal_length_mm", 1e-2, 1e5), _number(path, table, "sensor_size_mm", 1e-2, 1e5)
    sides = [_number(path, table, f"image_resolution_{axis}_px", 1, 1e5) or 0.0 for axis in "xy"]
    focus = _number(path, table, "focus_distance_m", 1e-4, 1e6)
    return Geometry(
        baseline_mm=_number(path, table, "baseline_mm", 1e-6, 1e7),
        focus_distance_mm=focus * 1000 if focus else None,
        focal_length_px=focal / sensor * max(sides) if focal and sensor and max(sides) else None,
    )


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    views = {int(found[1]): name for name in listing.names if (found := _VIEW.fullmatch(name))}
    if not views:
        raise UserError(f"{listing.path}: no input_Cam000.png, input_Cam001.png, ...", "give the folder that contains them")
    cfg = listing.file("parameters.cfg") if "parameters.cfg" in listing.names else None
    geometry, grid = Geometry(), parse_grid(scene.grid)
    if cfg:
        table = _parameters(cfg)
        geometry = _geometry(cfg, table)
        said = _number(cfg, table, "num_cams_y", 1, MAX_SIDE), _number(cfg, table, "num_cams_x", 1, MAX_SIDE)
        if grid is None and said[0] and said[1]:
            grid = int(said[0]), int(said[1])
    maps = {name: found for name in sorted(listing.names, key=len) if (found := _TRUTH.fullmatch(name))}
    if grid is None and not maps:
        return _by_names(listing, scene)
    rows, cols = grid or (math.isqrt(max(views)) + 1,) * 2
    if max(views) >= rows * cols:
        last = views[max(views)]
        raise UserError(f"{listing.path}: {last} is outside of the grid of {rows}x{cols}", "use --set scene.grid=ROWSxCOLS")
    files = {divmod(index, cols): listing.file(name) for index, name in views.items()}
    require_whole(listing, files, rows, cols, views[min(views)], grouped=False)
    truth: dict[tuple[int, int], Callable[[], NDArray[np.float32]]] = {}
    for name, found in maps.items():  # a map that names its view is last and wins
        index = int(found[1]) if found[1] else (rows // 2) * cols + cols // 2
        if index < rows * cols:
            truth[divmod(index, cols)] = partial(read_pfm, listing.file(name))
    return files_source(
        NAME, listing, files, rows, cols, turn=Turn(), turn_by=_CONVENTION, truth=truth, geometry=geometry,
        extra_files=(*(listing.file(name) for name in maps), *([cfg] if cfg else [])),
    )  # fmt: skip


def _by_names(listing: Listing, scene: config.Scene) -> SceneSource:
    """The scene where only the names are of the benchmark: the pictures decide the grid, and may contradict the order."""
    source = describe_views(NAME, listing, scene, runs=True)
    usual = source.rows == source.cols and not source.doubt
    return attrs.evolve(source, turn=Turn(), turn_firm=False, turn_by=_CONVENTION) if usual else source
