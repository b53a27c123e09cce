"""One picture file per view: the names of known data sets, any names whose numbers span a grid or
run, and camera poses.

- hci: the HCI 4D benchmark: input_Cam000.png ... row by row from the top left, parameters.cfg, true
  disparity if given: https://lightfield-analysis.uni-konstanz.de (Honauer, Johannsen,
  Kondermann, Goldluecke, ACCV 2016)
- stanford: the Stanford archive: out_RR_CC_Y_X_.png, Y and X the camera's position. The coordinates
  decide, not the index: X grows to the right, Y downwards, and scenes were shot in either
  direction. http://lightfield.stanford.edu
- rows-cols: any two numbers in the names that span a grid
- numbered: a running number: row by row, column by column, or a line, by the pictures
- poses: camera poses in a `transforms*.json`, as NeRF programs write it: a line or a grid of
  cameras that look the same way; names are not read, because programs number at random.
  `transform_matrix` is camera to world: columns right, up, backwards and position:
  https://github.com/NVlabs/instant-ngp/blob/master/docs/nerf_dataset_tips.md
  Poses without a picture are holes of the grid, pictures without a pose are not used.

The pictures may be in subfolders of the given folder: one folder per row, or all in the only folder
with pictures.
"""

import contextlib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache, partial
from itertools import takewhile

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.safe_files import TABLE_BYTES, finite, json_fields
from lfpipe.scene.layouts._grid import (
    FULL,
    coordinate_turn,
    describe_views,
    named_views,
    parse_grid,
    placed_views,
    some,
)
from lfpipe.scene.layouts._names import (
    MAX_SIDE,
    NO_SCENE,
    camera_of,
    eye_pairs,
    is_map,
    pairs,
    read_names,
    words,
)
from lfpipe.scene.layouts.arrays import LARGEST
from lfpipe.scene.source import (
    DEEPEST,
    MAX_FILES,
    Geometry,
    GridTransform,
    Layout,
    Listing,
    SceneSource,
    ViewIndex,
    list_scene,
    read_bytes,
    read_pfm,
    stem_of,
)

MOST_CAMERAS = 4  # that recorded side by side, of which two are a pair; more are a row


def inner_listing(listing: Listing, deepest: int = DEEPEST) -> Listing | None:
    """The pictures in subfolders, as names with a slash or as the only inner folder; None if there
    are none, or no more than in the folder itself. Raises UserError if the subfolders are separate
    scenes.
    """
    inner = _with_pictures(listing)
    if not inner and deepest and not listing.is_file:
        below = (inner_listing(one, deepest - 1) for one in subfolders(listing).values())
        return next(filter(None, below), None)
    pair = paired(inner)
    if not pair and (len(inner) > 1 or listing.pictures()):
        inner = {
            name: one
            for name, one in inner.items()
            if not is_map(name) and not NO_SCENE.search(words(name))
        }
        pair = paired(inner)
    if pair:
        inner = {name: inner[name] for name in pair}
    names = tuple(f"{folder}/{name}" for folder, one in inner.items() for name in one.pictures())
    if len(names) <= len(listing.pictures()):
        return None
    if len(inner) == 1:
        return next(iter(inner.values()))
    if not _are_parts(inner):
        most = max(inner, key=lambda name: len(inner[name].pictures()))
        raise UserError(
            f"{listing.path}: pictures are in {len(inner)} folders: {', '.join(list(inner)[:4])}",
            f"give one of them, {listing.path / most}; if the folders are rows of one scene, name"
            " them row_01, row_02",
        )
    return attrs.evolve(listing, names=names, folders=())


def subfolders(listing: Listing) -> dict[str, Listing]:
    """The readable subfolders, by name."""
    readable = {}
    for name in () if listing.is_file else listing.folders:
        with contextlib.suppress(UserError):
            readable[name] = list_scene(listing.file(name))
    return readable


def _with_pictures(listing: Listing, deepest: int = DEEPEST) -> dict[str, Listing]:
    """The subfolders with pictures, by name; one without pictures is replaced by the only one in it
    that has some: cam0/data beside cam0/sensor.yaml.
    """
    folders = {}
    for name, one in subfolders(listing).items():
        below = {} if one.pictures() or not deepest else _with_pictures(one, deepest - 1)
        if one.pictures():
            folders[name] = one
        elif len(below) == 1:
            folders |= {f"{name}/{path}": inner for path, inner in below.items()}
    return folders


def paired(inner: Mapping[str, Listing]) -> list[str]:
    """The first two folders that belong together by their words: of the left eye and of the right
    one, of two cameras with pictures of the same names, of colour and of depth; [] if there are
    none.
    """
    pictures = [name for name in inner if not is_map(name)]
    cameras = {number: name for name in pictures for number in camera_of(name)}
    beside = [
        (name, cameras[word, number + 1])
        for (word, number), name in cameras.items()
        if (word, number + 1) in cameras
        and inner[name].names == inner[cameras[word, number + 1]].names
    ]
    row = len(cameras) > MOST_CAMERAS and len({word for word, _ in cameras}) == 1
    candidates = [*eye_pairs(pictures), *([] if row else beside), *pairs([*inner])]
    return list(candidates[0]) if candidates else []


def _are_parts(inner: dict[str, Listing]) -> bool:
    """Whether folders are rows of one scene, or a pair: their names are a pair's, or differ in a
    number only. A grid in each folder means one scene per folder.
    """
    if paired(inner):
        return True
    rows = read_names(tuple(inner))
    grids = [read_names(tuple(one.pictures())) for one in inner.values()]
    numbered = rows is not None and len(rows.views) == len(inner)
    return numbered and all(grid is None or grid.runs for grid in grids)


def note_of(outer: Listing, inner: Listing) -> str:
    """A note of the used and unused pictures of a folder; "" if all are used."""
    only = {inner.path.relative_to(outer.path).as_posix()} if inner.path != outer.path else set()
    used = only or {name.rpartition("/")[0] for name in inner.names}
    others = outer.pictures() + [f"{name}/" for name in _with_pictures(outer) if name not in used]
    notes = [f"the pictures are those of {name}" for name in only]
    return "; ".join(notes + [f"not used: {some(others)}"] * bool(others))


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
    return attrs.evolve(source, truth=truth, files=(*source.files, *map(listing.file, maps), *cfg))


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


_ALIGNED = 0.1  # deviation from a row or column, and in depth, over the extent of all cameras
_ALIKE = 0.97  # cosine between viewing directions: 14 degrees
_REMEDY = "move it away to have the pictures ordered by name"


def pose_files(listing: Listing) -> list[str]:
    """The names of a folder's files of poses."""
    named = [n for n in listing.names if n.startswith("transforms") and n.endswith(".json")]
    return [] if listing.is_file else named


def _poses(listing: Listing) -> dict[str, NDArray[np.float64]]:
    """Camera-to-world matrices (3, 4) by the path that the files state, without entries that are
    none. Raises UserError for a file that is no list of poses.
    """
    poses: dict[str, NDArray[np.float64]] = {}
    for file in pose_files(listing):
        fields = json_fields(read_bytes(listing.file(file), TABLE_BYTES), file, _REMEDY)
        if not isinstance(frames := fields.values.get("frames"), list):
            raise UserError(f"{file} is not a list of poses", _REMEDY)
        for frame in frames[:MAX_FILES]:
            with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):
                matrix = np.array(frame["transform_matrix"], np.float64)[:3].reshape(3, 4)
                if np.abs(matrix).max() < LARGEST:
                    poses[frame["file_path"].replace("\\", "/")] = matrix
    return poses


def _below(listing: Listing, deepest: int = DEEPEST) -> Iterator[str]:
    """The names of pictures, with their folders."""
    yield from listing.pictures()
    for folder, inner in subfolders(listing).items() if deepest else ():
        yield from (f"{folder}/{name}" for name in _below(inner, deepest - 1))


def _pictures(listing: Listing, stated: Iterable[str]) -> dict[str, str]:
    """The stated path of each picture that has one. Paths may be those of another machine, with
    another ending or none: of pictures with that name, the one whose folders agree.
    """
    by_stem: dict[str, list[str]] = {}
    for name in _below(listing):
        by_stem.setdefault(stem_of(name.rpartition("/")[2]).lower(), []).append(name)
    paths = {}
    for path in stated:
        *folders, last = path.split("/")

        def alike(
            name: str, folders: list[str] = folders, last: str = last
        ) -> tuple[int, bool, bool]:
            ends = zip(name.split("/")[-2::-1], folders[::-1], strict=False)
            same = len([*takewhile(lambda both: both[0] == both[1], ends)])
            return same, not is_map(name), name.endswith(last)

        if names := by_stem.get(stem_of(last).lower()):
            paths[max(names, key=alike)] = path
    return paths


@lru_cache(maxsize=2)
def _cameras(listing: Listing) -> tuple[dict[str, ViewIndex], NDArray[np.float64], str]:
    """(grid index, position (down, right)) of each camera, and why there are none, "" if there are
    some: they form neither a line nor a grid, or look in different directions.
    """
    nothing = np.zeros((0, 2))
    try:
        poses = _poses(listing)
    except UserError as error:
        return {}, nothing, error.message
    names = _pictures(listing, poses)
    cameras = np.array([poses[path] for path in names.values()]).reshape(-1, 3, 4)
    if len(cameras) < 3:
        return {}, nothing, f"{len(cameras)} of its {len(poses)} poses have a picture here"
    right, up, back = cameras[:, :, :3].mean(axis=0).T
    at = cameras[:, :, 3] @ np.stack((-up, right, back), axis=1)
    down, across, deep = np.ptp(at, axis=0).tolist()
    extent = max(down, across)
    rows, cols = (_steps(at[:, axis], extent) for axis in (0, 1))
    if not rows.any() or not cols.any():  # a line: steps may differ
        rows, cols = (
            np.argsort(np.argsort(at[:, k])) * used.any() for k, used in ((0, rows), (1, cols))
        )
    indices = list(zip(rows.tolist(), cols.tolist(), strict=True))
    if not (cameras[:, :, 2] @ back).min() > _ALIKE:
        return {}, nothing, "its cameras look in different directions"
    size = (rows.max() + 1) * (cols.max() + 1)
    if len(set(indices)) < len(indices) or len(indices) < FULL * size or deep > _ALIGNED * extent:
        return {}, nothing, "its cameras form neither a line nor a grid"
    return dict(zip(names, indices, strict=True)), at[:, :2], ""


def _steps(values: NDArray[np.float64], extent: float) -> NDArray[np.intp]:
    """The row (or column) of each camera: gaps of more than half the largest separate them."""
    order = np.argsort(values)
    gaps = np.diff(values[order])
    steps = np.zeros(len(values), np.intp)
    if np.ptp(values) > _ALIGNED * extent:
        steps[order[1:]] = np.cumsum(gaps > gaps.max() / 2)
    return steps


def unused_poses(listing: Listing) -> list[str]:
    """A note of why a folder's poses are not used; [] if it has none."""
    files = pose_files(listing)
    why = _cameras(listing)[2] if files else ""
    return [f"{files[0]} is not used: {why}"] if why else []


def _describe_poses(listing: Listing, scene: config.Scene) -> SceneSource:
    places, at, why = _cameras(listing)
    if not places:
        raise UserError(
            f"{listing.path}: no transforms.json with cameras along a line or over a grid: {why}",
            "leave out scene.layout",
        )
    source = placed_views("poses", listing, places)
    positions = np.full((source.rows, source.cols, 2), np.nan)
    for place, position in zip(places.values(), at, strict=True):
        positions[place] = position
    others = [name for name in _below(listing) if name not in places and not is_map(name)]
    return attrs.evolve(
        source,
        files=(*source.files, *map(listing.file, pose_files(listing))),
        coordinates=positions,
        turn=GridTransform(),
        turn_firm=False,  # some programs write other axes
        turn_by="camera poses",
        notes=(
            "placed by the poses in " + some(pose_files(listing)),
            *([f"without a pose, not used: {some(others)}"] if others else ()),
            *source.notes,
        ),
    )


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
    Layout(
        "poses",
        lambda listing: 85 if pose_files(listing) and _cameras(listing)[0] else None,
        _describe_poses,
    ),
)
