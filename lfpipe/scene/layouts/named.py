"""One picture file per view: the names of known data sets, and any names whose numbers span a grid
or run.

- hci: the HCI 4D benchmark: input_Cam000.png ... row by row from the top left, parameters.cfg, true
  disparity if given: https://lightfield-analysis.uni-konstanz.de (Honauer, Johannsen,
  Kondermann, Goldluecke, ACCV 2016)
- stanford: the Stanford archive: out_RR_CC_Y_X_.png, Y and X the camera's position. The coordinates
  decide, not the index: X grows to the right, Y downwards, and scenes were shot in either
  direction. http://lightfield.stanford.edu
- rows-cols: any two numbers in the names that span a grid
- numbered: a running number: row by row, column by column, or a line, by the pictures
"""

import math
import re
from collections.abc import Callable
from functools import partial

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.untrusted import finite
from lfpipe.scene.files import Listing, read_bytes, read_pfm
from lfpipe.scene.layouts._grid import (
    coordinate_turn,
    describe_views,
    named_views,
    parse_grid,
    placed_views,
)
from lfpipe.scene.layouts._names import MAX_SIDE
from lfpipe.scene.layouts.arrays import LARGEST
from lfpipe.scene.source import Geometry, GridTransform, Layout, SceneSource

_NUMBER, _PICTURE = r"(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)", r"\.(?:png|jpe?g|ppm)"
_HCI = re.compile(rf"input_Cam(\d{{3,5}}){_PICTURE}", re.IGNORECASE)
_STANFORD = re.compile(
    rf".*?out_(\d{{1,4}})_(\d{{1,4}})_{_NUMBER}_{_NUMBER}(?:_{_NUMBER})*_?{_PICTURE}", re.IGNORECASE
)
_TRUTH = re.compile(r"gt_disp_lowres(?:_Cam(\d{3,5}))?\.pfm", re.IGNORECASE)


def _matches(listing: Listing, pattern: re.Pattern[str]) -> dict[str, re.Match[str]]:
    """The names of a folder's files that match the pattern."""
    return {name: match for name in listing.names if (match := pattern.fullmatch(name))}


def _require_matches(
    listing: Listing, pattern: re.Pattern[str], example: str
) -> dict[str, re.Match[str]]:
    if not (matches := _matches(listing, pattern)):
        raise UserError(
            f"{listing.path}: no {example}",
            "give the folder of the views, or leave out scene.layout",
        )
    return matches


def _detect(pattern: re.Pattern[str], listing: Listing) -> int | None:
    return 90 if len(_matches(listing, pattern)) > 1 else None


def _describe_hci(listing: Listing, scene: config.Scene) -> SceneSource:
    views = {
        name: int(match[1])
        for name, match in _require_matches(listing, _HCI, "input_Cam000.png").items()
    }
    cfg = [listing.file("parameters.cfg")] if "parameters.cfg" in listing.names else []
    text = read_bytes(cfg[0]).decode("utf-8", "replace").lower() if cfg else ""
    parameters = dict(re.findall(r"^[^\S\n]*(\w+)[^\S\n]*[=:][^\S\n]*(\S+)", text, re.MULTILINE))

    def number(key: str, low: float, high: float) -> float | None:
        """None if it is missing or out of range; zero and text also mean "unknown"."""
        return finite(parameters.get(key, ""), low, high)

    focal, sensor = number("focal_length_mm", 1e-2, 1e5), number("sensor_size_mm", 1e-2, 1e5)
    longer_px = max(number(f"image_resolution_{axis}_px", 1, 1e5) or 0.0 for axis in "xy")
    focus = number("focus_distance_m", 1e-4, 1e6)
    geometry = Geometry(
        baseline_mm=number("baseline_mm", 1e-6, 1e7),
        focus_distance_mm=focus * 1000 if focus else None,
        focal_length_px=focal / sensor * longer_px if focal and sensor and longer_px else None,
    )
    rows, cols = parse_grid(scene.grid) or [
        int(number(f"num_cams_{axis}", 1, MAX_SIDE) or 0) for axis in "yx"
    ]
    maps = {
        name: match for name in sorted(listing.names, key=len) if (match := _TRUTH.fullmatch(name))
    }
    convention = "the HCI layout is row by row from the top left camera"
    # only the names follow the benchmark: the pictures decide, and may contradict the order
    if not rows * cols and not maps:
        source = describe_views("hci", listing, scene, runs=True)
        return (
            attrs.evolve(source, turn=GridTransform(), turn_firm=False, turn_by=convention)
            if (source.rows == source.cols and not source.doubt)
            else source
        )
    last = max(views, key=lambda name: views[name])
    if not rows * cols:
        rows = cols = math.isqrt(views[last]) + 1
    if views[last] >= rows * cols:
        raise UserError(
            f"{listing.path}: {last} is outside of the grid of {rows}x{cols}",
            "use --set scene.grid=ROWSxCOLS",
        )
    source = placed_views(
        "hci",
        listing,
        {name: divmod(index, cols) for name, index in views.items()},
        (rows, cols),
        turn=GridTransform(),
        turn_by=convention,
        geometry=geometry,
    )
    truth: dict[tuple[int, int], Callable[[], NDArray[np.float32]]] = {}
    for name, match in maps.items() if (source.rows, source.cols) == (rows, cols) else ():
        # a map with a view number in its name is last and takes precedence
        index = int(match[1]) if match[1] else (rows // 2) * cols + cols // 2
        if index < rows * cols and divmod(index, cols) not in source.missing:
            truth[divmod(index, cols)] = partial(read_pfm, listing.file(name))
    beside = (*(listing.file(name) for name in maps), *cfg)
    return attrs.evolve(source, truth=truth, files=(*source.files, *beside))


def _describe_stanford(listing: Listing, scene: config.Scene) -> SceneSource:
    matches = _require_matches(listing, _STANFORD, "out_ROW_COLUMN_Y_X_.png")
    source = placed_views(
        "stanford", listing, {name: (int(m[1]), int(m[2])) for name, m in matches.items()}
    )
    camera_positions = np.full((source.rows, source.cols, 2), np.nan)
    for place, path in zip(source.places, source.files, strict=True):
        for axis in (0, 1):
            value = finite(matches[path.name][3 + axis], -LARGEST, LARGEST)
            camera_positions[place][axis] = np.nan if value is None else value
    turn = coordinate_turn(camera_positions)
    if turn is None:
        return source
    return attrs.evolve(
        source,
        coordinates=camera_positions if np.isfinite(camera_positions).all() else None,
        turn=turn,
        turn_by="camera coordinates in the names",
    )


def _detect_numbers(runs: bool, mark: int, listing: Listing) -> int | None:
    numbered = named_views(listing)
    return mark if numbered is not None and numbered.runs == runs else None


LAYOUTS = (
    Layout("hci", partial(_detect, _HCI), _describe_hci),
    Layout("stanford", partial(_detect, _STANFORD), _describe_stanford),
    Layout(
        "rows-cols",
        partial(_detect_numbers, False, 50),
        partial(describe_views, "rows-cols", runs=False),
    ),
    Layout(
        "numbered",
        partial(_detect_numbers, True, 40),
        partial(describe_views, "numbered", runs=True),
    ),
)
