"""A grid of picture files, one per view: what several layouts share."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.scene.files import Listing, read_picture
from lfpipe.scene.source import Source

Place = tuple[int, int]


def asked_grid(text: str) -> Place | None:
    """`scene.grid` as (rows, cols), None where empty. Raises UserError."""
    if not text:
        return None
    found = re.fullmatch(r"\s*(\d{1,4})\s*[xX×]\s*(\d{1,4})\s*", text)
    if not found or int(found[1]) * int(found[2]) == 0:
        raise UserError(f"scene.grid: {text!r} is not ROWSxCOLS", "for example --set scene.grid=9x9")
    return int(found[1]), int(found[2])


def true_max(values: list[int], full: int) -> int:
    """The value that stands for full where 16-bit files may hold 10, 12 or 14 bits: by the largest value of some views."""
    if full != 65535:
        return full
    return next((top for top in (1023, 4095, 16383) if max(values) <= top), full)


def named_grid(pairs: Mapping[Place, str], listing: Listing) -> tuple[dict[Place, Path], int, int]:
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
            "are the last two numbers of the names row and column? Name another layout with --set scene.layout=NAME",
        )
    files = {((r - lows[0]) // steps[0], (c - lows[1]) // steps[1]): listing.file(name) for (r, c), name in pairs.items()}
    return files, counts[0], counts[1]


def require_whole(listing: Listing, files: Mapping[Place, Path], rows: int, cols: int, example: str) -> None:
    """Raises UserError that names the views without a file."""
    holes = [(r, c) for r in range(rows) for c in range(cols) if (r, c) not in files]
    if holes:
        some = ", ".join(f"row {r} column {c}" for r, c in holes[:6]) + (f" and {len(holes) - 6} more" if len(holes) > 6 else "")
        raise UserError(
            f"{listing.path}: {len(holes)} of {rows}x{cols} views missing: {some} (counted from 0; a file like {example})",
            "fetch the missing files, or give the true grid with --set scene.grid=ROWSxCOLS",
        )


def files_source(layout: str, listing: Listing, files: Mapping[Place, Path], rows: int, cols: int, **more: Any) -> Source:
    """A Source that reads one picture file per view. Size and depth are those of the middle view; a view of another
    size or depth raises UserError when read. more: further fields of Source; extra_files joins its files."""
    middle = min(files, key=lambda place: (abs(place[0] - rows // 2) + abs(place[1] - cols // 2), place))
    first, full = read_picture(files[middle])
    height, width = first.shape[:2]
    some = [files[place] for place in (min(files), max(files))]
    top = full if full != 65535 else true_max([int(first.max()), *(int(read_picture(path)[0].max()) for path in some)], full)

    def read(frame: int, row: int, col: int) -> NDArray[Any]:
        path = files[row, col]
        pixels, its_full = read_picture(path)
        if pixels.shape[:2] != (height, width):
            raise UserError(
                f"{path}: {pixels.shape[1]}x{pixels.shape[0]} px, but {files[middle].name} has {width}x{height}",
                "every view of a light field has the same size; export this one again",
            )
        if its_full != full:
            raise UserError(
                f"{path}: {its_full.bit_length()}-bit, but {files[middle].name} is {full.bit_length()}-bit",
                "every view of a light field has the same depth; export this one again",
            )
        return pixels

    extra = tuple(more.pop("extra_files", ()))
    missing = frozenset((r, c) for r in range(rows) for c in range(cols) if (r, c) not in files)
    return Source(
        layout=layout,
        path=listing.path,
        files=tuple(files[place] for place in sorted(files)) + extra,
        rows=rows,
        cols=cols,
        read=read,
        height_px=height,
        width_px=width,
        max_value=top,
        missing=missing,
        **more,
    )
