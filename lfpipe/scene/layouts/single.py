"""Scenes of one file that is no mosaic: a picture, which is a light field of one view, and an
animation (GIF, WebP, AVIF) or video whose frames are views: along a line, as in a wiggle, or of a
grid.
"""

import math
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import MAX_DECODING_BYTES, open_header, read_frames, read_picture
from lfpipe.scene.files import VIDEOS, Listing
from lfpipe.scene.layouts._grid import described_run, files_source, misfit, parse_grid
from lfpipe.scene.layouts._running import lay_out
from lfpipe.scene.layouts._tiles import plane_of, reduced, require_picture, single_picture
from lfpipe.scene.optical_flow import returned_flow, textured
from lfpipe.scene.plausibility import gather_evidence
from lfpipe.scene.source import Layout, SceneSource, Turn
from lfpipe.scene.video import Video

# longer side of the examined copy; px of detail that red and green must share
_GLANCE_PX, _FEWEST_PX = 512, 300
# between red and green: more than lens errors; less in a picture that is called one
_ASIDE_PX, _NAMED_ASIDE_PX = 1.5, 0.5
_DOWN_SHARE = 0.15  # of the motion across: a pair of eyes looks from one height
_ANAGLYPH = re.compile(r"anaglyph|(?<![a-z])(red|rot|rouge|rosso)[-_ ]?(cyan|blue|blau|bleu|blu)")
_SMALL_PX = 128  # side of frames that are compared
_STILLS = ("JPEG", "TIFF", "HEIF")  # of which several in one file are no animation
_SAME = 2.0  # grey levels between frames of one view: dithering


def _is_anaglyph(picture: NDArray[Any], name: str) -> bool:
    """Whether red is shifted against green and blue like one eye's picture against the other's."""
    if picture.ndim == 2:
        return False
    small = reduced(picture, _GLANCE_PX)
    red, green = (
        np.asarray(cv2.equalizeHist(plane_of(small[..., channel])), np.uint8) for channel in (0, 1)
    )
    if min(red.shape) < 24:
        return False
    aside, confirmed = returned_flow(red, green)
    detail = confirmed & textured(green)
    if np.count_nonzero(detail) < _FEWEST_PX:
        return False
    across, down = np.abs(aside[detail]).T
    across_px = float(np.percentile(across, 70))
    least_px = _NAMED_ASIDE_PX if _ANAGLYPH.search(name.lower()) else _ASIDE_PX
    return bool(across_px > least_px and np.median(down) < max(0.5, _DOWN_SHARE * across_px))


def _describe_picture(listing: Listing, scene: config.Scene) -> SceneSource:
    path = require_picture(listing)
    if not scene.force and _is_anaglyph(read_picture(path)[0], path.stem):
        raise UserError(
            f"{path}: is a red/cyan anaglyph: each eye's picture has lost its other colours, so"
            " the two cannot be separated",
            "give the stereo pair that it was made of; --set scene.force=true shows it flat",
        )
    notes = tuple(f"{name} is the same picture" for name in listing.pictures() if name != path.name)
    return files_source(
        "picture",
        listing,
        {(0, 0): path.name},
        (1, 1),
        turn=Turn(),
        turn_by="there is one view",
        notes=notes,
    )


@lru_cache(maxsize=2)
def _animation(listing: Listing) -> Path | None:
    path = single_picture(listing)
    header = open_header(path) if path else None
    return path if header and header.frames > 1 and header.format not in _STILLS else None


def _one_way(frames: list[NDArray[Any]]) -> list[NDArray[Any]]:
    """The frames before the sequence reverses; all of them if it does not."""

    def same(a: int, b: int) -> bool:
        return float(cv2.norm(frames[a], frames[b], cv2.NORM_L1)) < _SAME * frames[a].size

    count = len(frames)
    for last, back in ((count // 2, count), (count // 2 - 1, count - 1)):
        pairs = [(k, back - k) for k in range(last) if back - k < count and k < back - k]
        if (
            len(pairs) >= max(1, (count - 1) // 2)
            and count > 2
            and all(same(a, b) for a, b in pairs)
        ):
            return frames[: back // 2 + 1]
    return frames


def _frames(path: Path) -> list[NDArray[Any]]:
    """All frames of an animation or video. Raises UserError."""
    if not path.name.lower().endswith(VIDEOS):
        return list(read_frames(path))
    video = Video(path)
    if video.frames * video.height_px * video.width_px * 3 > MAX_DECODING_BYTES:
        raise UserError(
            f"{path}: {video.frames} frames of {video.width_px}x{video.height_px} px: no tiles are"
            " recognised in them, and they are too many for views",
            f"if the camera slid sideways, make views with `lfpipe scene make {path}`; give the"
            " frames of a grid as pictures in a folder",
        )
    return [video.read(frame) for frame in range(video.frames)]


def _describe_animation(listing: Listing, scene: config.Scene) -> SceneSource:
    is_video = listing.is_file and listing.names[0].lower().endswith(VIDEOS)
    path = listing.file(listing.names[0]) if is_video else _animation(listing)
    path = path or require_picture(listing)
    frames = _frames(path)
    grid = parse_grid(scene.grid)
    given = grid is not None and math.prod(grid) == len(frames)
    views = frames if given else _one_way(frames)
    small = [plane_of(reduced(view, _SMALL_PX)) for view in views]
    run, places, again = lay_out(small.__getitem__, [True] * len(views), grid, range(len(views)))
    if run is None:
        raise misfit(str(path), len(views), grid)
    at = {run.index(place): views[position] for position, place in places.items()}
    notes = [f"frame {late} is the same picture as frame {early}" for late, early in again.items()]
    if len(views) < len(frames):
        notes.append(
            f"{len(views)} of {len(frames)} frames are used: the others go back the same way"
        )
    if run.rows > 1:
        notes.append(described_run(run, grid))
    height, width = views[0].shape[:2]
    source = SceneSource(
        certain=False,
        layout="gif",
        path=listing.path,
        files=(path,),
        rows=run.rows,
        cols=run.cols,
        read=lambda frame, row, col: at[row, col],
        missing=frozenset(set(np.ndindex(run.shape)) - set(at)),
        height_px=height,
        width_px=width,
        doubt=run.doubt,
        notes=tuple(notes),
    )
    unsteady = is_video and run.rows == 1 and scene.layout == "auto" and not grid
    evidence = gather_evidence(source) if unsteady else None
    if unsteady and not (evidence and evidence.change):
        raise UserError(
            f"{path}: no tiles were recognised in {width}x{height} px, and its frames form no grid",
            f"if the camera slid sideways, make views with `lfpipe scene make {path}`; else give"
            " the tiles with --set scene.grid=ROWSxCOLS, or open the frames as one line with --set"
            " scene.layout=gif",
        )
    return source


def _detect_animation(listing: Listing) -> int | None:
    if listing.is_file and listing.names[0].lower().endswith(VIDEOS):
        return 50  # one of tiles is more specific
    return None if _animation(listing) is None else 90


LAYOUTS = (
    Layout(
        "picture",
        lambda listing: None if single_picture(listing) is None else 10,
        _describe_picture,
    ),
    Layout("gif", _detect_animation, _describe_animation),
)
