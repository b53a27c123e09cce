"""A grid of picture files, one per view: what several layouts share."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.pictures import MAX_DECODING_BYTES, open_header, read_picture, small_grey
from lfpipe.scene.files import MAX_FILES, Listing
from lfpipe.scene.source import SceneSource, ViewIndex

LOSSY = (".jpg", ".jpeg", ".webp", ".avif", ".gif")
MAX_SIDE = 10_000  # views along one side of a grid
MAX_VIEWS = MAX_FILES


def parse_grid(text: str) -> ViewIndex | None:
    """`scene.grid` as (rows, cols), None where empty. Raises UserError."""
    if not text:
        return None
    found = re.fullmatch(r"\s*(\d{1,4})\s*[xX×]\s*(\d{1,4})\s*", text)
    if not found or int(found[1]) * int(found[2]) == 0:
        raise UserError(f"scene.grid: {text!r} is not ROWSxCOLS", "use for example --set scene.grid=9x9")
    require_grid(int(found[1]), int(found[2]), "scene.grid")
    return int(found[1]), int(found[2])


def require_grid(rows: int, cols: int, what: str) -> None:
    """Raises UserError where no light field has such a grid. what: who says so."""
    if not (1 <= rows <= MAX_SIDE and 1 <= cols <= MAX_SIDE and rows * cols <= MAX_VIEWS):
        most = f"at most {MAX_SIDE} along a side and {MAX_VIEWS} together"
        raise UserError(
            f"{what}: a grid of {rows}x{cols} views, {most} are expected", "give the true one with --set scene.grid=ROWSxCOLS"
        )


def require_view(height: int, width: int, sample_bytes: int, what: str) -> None:
    """Raises UserError where no view is so large. what: who says so."""
    if min(height, width) < 1 or height * width * 3 * sample_bytes > MAX_DECODING_BYTES:
        most = f"at most {MAX_DECODING_BYTES / 1e6:.0f} MB each"
        raise UserError(f"{what}: views of {width}x{height} px, expected {most}", "export it with smaller views")


def true_max(values: list[int], full: int) -> int:
    """The value that stands for full where 16-bit files may hold 10, 12 or 14 bits: by the largest value of some views."""
    if full != 65535:
        return full
    return next((top for top in (1023, 4095, 16383) if max(values) <= top), full)


def named_grid(pairs: Mapping[ViewIndex, str], listing: Listing) -> tuple[dict[ViewIndex, Path], int, int]:
    """Files by (row, column) numbers as they stand in the names -> files by place from (0, 0), rows, cols.

    Numbers may start anywhere and go in equal steps (rows 0, 4, 8). Every path is checked to lie in the folder.
    Raises UserError where the numbers span far more places than there are files.
    """
    lows, steps, counts = [], [], []
    for axis in (0, 1):
        numbers = {pair[axis] for pair in pairs}
        lows.append(min(numbers))
        steps.append(math.gcd(*(number - lows[axis] for number in numbers)) or 1)
        counts.append((max(numbers) - lows[axis]) // steps[axis] + 1)
    if counts[0] * counts[1] > 16 * len(pairs) + 64:
        raise UserError(
            f"{listing.path}: the names span {counts[0]}x{counts[1]} views, {len(pairs)} files are there",
            "give a folder with the views of only one scene",
        )
    files = {((r - lows[0]) // steps[0], (c - lows[1]) // steps[1]): listing.file(name) for (r, c), name in pairs.items()}
    return files, counts[0], counts[1]


def require_whole(
    listing: Listing, files: Mapping[ViewIndex, Path], rows: int, cols: int, example: str, grouped: bool = True
) -> None:
    """Raises UserError that names the views without a file, or where no light field has such a grid. grouped: whether the names
    hold row and column."""
    require_grid(rows, cols, str(listing.path))
    holes = [(r, c) for r in range(rows) for c in range(cols) if (r, c) not in files]
    if holes:
        some = ", ".join(f"row {r} column {c}" for r, c in holes[:6]) + (f" and {len(holes) - 6} more" if len(holes) > 6 else "")
        raise UserError(
            f"{listing.path}: {len(holes)} of {rows}x{cols} views missing: {some} (counted from 0; a file like {example})",
            f"fetch the missing files; --layout {'rows-cols' if grouped else 'numbered'} opens the others",
        )


def files_source(
    layout: str, listing: Listing, files: Mapping[ViewIndex, Path], rows: int, cols: int, **more: Any
) -> SceneSource:
    """A SceneSource that reads one picture file per view. Size and depth are those of the middle view; a view of another
    size or depth raises UserError when read. more: further fields of SceneSource; extra_files joins its files; headers: of
    files, where they are known."""
    middle = min(files, key=lambda place: (abs(place[0] - rows // 2) + abs(place[1] - cols // 2), place))
    known = more.pop("headers", {})
    headers = {place: known.get(path) or open_header(path) for place, path in files.items()}
    first = headers[middle]
    for place, header in headers.items():
        for what, here, there in (
            (" px", f"{header.width_px}x{header.height_px}", f"{first.width_px}x{first.height_px}"),
            ("-bit", str(header.max_value.bit_length()), str(first.max_value.bit_length())),
        ):
            if here != there:
                raise UserError(
                    f"{files[place]}: {here}{what}, but {files[middle].name} has {there}{what}",
                    "every view of a light field has the same size and depth; export this one again",
                )
    full = first.max_value
    if full == 65535:
        full = true_max([int(read_picture(files[place])[0].max()) for place in {min(files), middle, max(files)}], full)

    def read(frame: int, row: int, col: int) -> NDArray[Any]:
        return read_picture(files[row, col], headers[row, col])[0]

    def small(row: int, col: int, most_px: float) -> NDArray[np.uint8]:
        return small_grey(files[row, col], headers[row, col], most_px)

    extra = tuple(more.pop("extra_files", ()))
    missing = frozenset((r, c) for r in range(rows) for c in range(cols) if (r, c) not in files)
    return SceneSource(
        layout=layout,
        path=listing.path,
        files=tuple(files[place] for place in sorted(files)) + extra,
        rows=rows,
        cols=cols,
        read=read,
        small=small if full in (255, first.max_value) else None,
        height_px=first.height_px,
        width_px=first.width_px,
        max_value=full,
        missing=missing,
        **more,
    )
