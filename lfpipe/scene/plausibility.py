"""Checks quickly, on a few small pictures, whether they form a light field, before all of them are packed.

Refusal needs two findings: views between two others are predicted badly from these, and no disparity explains the flow (it must
be equal to both neighbours, along the line of cameras). Focal stacks predict each other well; they are recognised by where they
are sharp, without parallax.
"""

from collections.abc import Callable
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.scene.grey_views import LOOK_PX, grey_views, present_lines
from lfpipe.scene.optical_flow import SMALLEST_PX, Grey, confirmed, flow, grid_xy, textured
from lfpipe.scene.source import SceneSource

_POOR_DB = 20.0  # of views between two others: lower ones do not fit
_EXPLAINED = 0.3  # share of textured pixels that one disparity explains: a light field has more
_FINE_DB, _FINE_SHARE = 26.0, 0.6  # of the middle of all lines: enough to skip other views
_UNEXPLAINED = 0.1  # below this share a few dB more do not help
_LOOSE_PX, _LOOSE_SHARE = 1.0, 0.2  # tolerance of the flow
_STILL_PX, _STILL_FAR_PX = 0.3, 1.0  # flow between neighbours of a focal stack, and between its middle and its ends
_REFOCUSED = 4.0  # ratio of the sharpest to the least sharp picture of a block, in a focal stack
_BLOCKS = 8
_SHORTEST_CIRCLE, _FEWEST_PX, _STAYS = 8, 200, 0.5  # views; pixels that move between them; share of these seen half-way round


@attrs.frozen
class Evidence:
    """held_out_db: PSNR of views predicted from two neighbours, median. explained: share of textured pixels whose flow one
    disparity explains. refocused: ratio of sharpness within blocks over the views, if nothing moves; 1 otherwise. circle: whether
    a line of views ends where it began."""

    held_out_db: float
    explained: float
    refocused: float = 1.0
    circle: bool = False

    @property
    def reason(self) -> str:
        """Why the pictures are no light field; "" if they may be one."""
        if self.refocused > _REFOCUSED:
            by = f"sharpness by a factor of {self.refocused:.0f}"
            return f"their focus or exposure differs ({by}), their viewpoint does not: a focal stack or a bracket"
        if self.circle:
            return "the last picture follows the first one: a turntable, or a walk around something"
        poor_db = _POOR_DB + 20 * max(0.0, _UNEXPLAINED - self.explained)
        if self.held_out_db < poor_db and self.explained < _EXPLAINED:
            return (
                f"quality when predicting views from their neighbours {self.held_out_db:.0f} dB, and one disparity explains "
                f"the motion of {self.explained:.0%} of the detail"
            )
        return ""


def _pair(a: Grey, b: Grey) -> tuple[float, float, float]:
    """As `_triple`, for two views: one predicted from the other, and the share of its detail found there."""
    there, xx_yy = flow(a, b), grid_xy(*a.shape)
    seen = cv2.remap(b, xx_yy[0] + there[..., 0], xx_yy[1] + there[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    found, detail = confirmed(there, flow(b, a)), textured(a)
    explained = float(found[detail].mean()) if detail.any() else 1.0
    return _psnr(seen.astype(np.float32), a.astype(np.float32)), explained, float(np.abs(there).max())


def _psnr(a: NDArray[Any], b: NDArray[Any]) -> float:
    return float(10 * np.log10(255**2 / max(0.01, float(np.mean(np.square(a - b))))))


def _unsteady(x: NDArray[np.intp], y: NDArray[np.intp], motion_px: NDArray[np.float32]) -> NDArray[np.float32]:
    """Motion of pixels, float32 (n,), without that of a hand: its least-squares fit by a shift, a turn and a zoom."""
    places = np.stack((np.ones(len(x)), x, y), axis=1).astype(np.float32)
    return np.asarray(motion_px - places @ np.linalg.lstsq(places, motion_px, rcond=None)[0], np.float32)


def _triple(before: Grey, middle: Grey, after: Grey) -> tuple[float, float, float]:
    """(PSNR of the middle view predicted from the others, share of its detail that one disparity explains, motion in px)."""
    height, width = middle.shape
    xx, yy = grid_xy(height, width)
    across = flow(before, after)
    sideways = float(np.abs(across[..., 0]).mean()) >= float(np.abs(across[..., 1]).mean())
    half = across[..., 0 if sideways else 1] / 2
    zero = np.zeros_like(half)
    predicted = np.zeros_like(half)
    for picture, sign in ((before, -1), (after, 1)):
        dx, dy = (sign * half, zero) if sideways else (zero, sign * half)
        seen = cv2.remap(picture, xx + dx, yy + dy, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        predicted += seen.astype(np.float32) / 2
    edge = max(1, min(height, width) // 20)
    inner = slice(edge, -edge), slice(edge, -edge)
    detail = textured(middle)
    if not detail.any():
        return _psnr(predicted[inner], middle[inner].astype(np.float32)), 1.0, 0.0
    to_before, to_after = (flow(middle, other)[detail] for other in (before, after))
    y, x = np.nonzero(detail)
    along, beside = (to_after[:, k] for k in ((0, 1) if sideways else (1, 0)))
    off = np.hypot(*(_unsteady(x, y, (to_before + to_after)[:, k]) for k in (0, 1)))
    loose = _LOOSE_PX + _LOOSE_SHARE * np.abs(along)
    explained = float(((off < loose) & (np.abs(_unsteady(x, y, beside)) < loose)).mean())
    motion = float(np.median(np.abs(along)))
    return _psnr(predicted[inner], middle[inner].astype(np.float32)), explained, motion


def _stand_still(views: list[Grey]) -> bool:
    """Whether nothing moves between views far apart, where steps too small to see would add up to parallax."""
    middle = views[len(views) // 2]
    detail = textured(middle)
    if not detail.any():
        return False
    moved = [float(np.median(np.hypot(*np.moveaxis(flow(middle, end)[detail], 1, 0)))) for end in (views[0], views[-1])]
    return max(moved) < _STILL_FAR_PX


def _refocused(views: list[Grey]) -> float:
    """Median over textured blocks of the sharpest over the least sharp picture; 1 if all blocks are sharpest in the same one."""
    side = max(8, min(views[0].shape) // _BLOCKS)
    sharp = []
    for view in views:
        detail = np.square(cv2.Laplacian(view, cv2.CV_32F, ksize=3))
        sharp.append(cv2.resize(detail, (view.shape[1] // side, view.shape[0] // side), interpolation=cv2.INTER_AREA).ravel())
    blocks = np.stack(sharp)
    use = blocks.max(axis=0) > max(30.0, float(np.median(blocks.max(axis=0))))
    if use.sum() < 4:
        return 1.0
    best, ratio = blocks[:, use].argmax(axis=0), blocks[:, use].max(axis=0) / (blocks[:, use].min(axis=0) + 5.0)
    return float(np.median(ratio)) if len(np.unique(best)) > 1 and np.bincount(best).max() < 0.8 * len(best) else 1.0


def _is_circle(first: Grey, second: Grey, middle: Grey, last: Grey) -> bool:
    """Whether what moves from the first view of a line to the second one comes from the last view by the same motion, and is not
    in the middle view, where a turntable shows the other side."""
    detail = textured(first)
    back, ahead = flow(first, last)[detail], flow(first, second)[detail]
    moving = np.hypot(*ahead.T) > _LOOSE_PX
    if np.count_nonzero(moving) < _FEWEST_PX:
        return False
    off = np.hypot(*(back + ahead)[moving].T)
    comes = float((off < _LOOSE_PX + _LOOSE_SHARE * np.hypot(*ahead[moving].T)).mean())
    stays = float(confirmed(flow(first, middle), flow(middle, first))[detail][moving].mean())
    return comes > _EXPLAINED and stays < _STAYS


def examine(source: SceneSource) -> Evidence | None:
    """Evidence from a few small views; None if there are too few, or they are too small."""
    if min(source.height_px, source.width_px) < 2 * SMALLEST_PX:
        return None
    grey: Callable[[int, int], Grey] = grey_views(source, LOOK_PX)
    lines = [line for line in present_lines(source) if len(line) >= 3]
    if not lines:
        pairs = [_pair(grey(*line[0]), grey(*line[1])) for line in present_lines(source) if len(line) == 2]
        held_out, explained, _ = (float(np.median(values)) for values in zip(*pairs or [(0.0, 0.0, 0.0)], strict=True))
        return Evidence(held_out, explained) if pairs else None
    found = [_triple(*(grey(*line[k + len(line) // 2]) for k in (-1, 0, 1))) for line in lines]
    if any(held_out < _FINE_DB or explained < _FINE_SHARE for held_out, explained, _ in found):
        for line in lines:
            for middle in {max(1, len(line) // 5), min(len(line) - 2, len(line) - 1 - len(line) // 5)} - {len(line) // 2}:
                found.append(_triple(*(grey(*line[middle + k]) for k in (-1, 0, 1))))
    held_out, explained, motion = (float(np.median(values)) for values in zip(*found, strict=True))
    every = [(r, c) for r in range(source.rows) for c in range(source.cols) if (r, c) not in source.missing]
    spread = sorted({round(p) for p in np.linspace(0, len(every) - 1, 9)})
    some = [grey(*every[k]) for k in spread] if motion < _STILL_PX else []
    refocused = _refocused(some) if some and _stand_still(some) else 1.0
    line = lines[0]
    ends = len(lines) == 1 and len(line) >= _SHORTEST_CIRCLE
    circle = ends and _is_circle(*(grey(*line[k]) for k in (0, 1, len(line) // 2, -1)))
    return Evidence(held_out, explained, refocused, circle)


def plausible(source: SceneSource, force: bool) -> SceneSource:
    """The source; if it is no light field, raises UserError, or with `force` adds a doubt."""
    evidence = examine(source)
    if evidence is None or not evidence.reason:
        return source
    why = f"the pictures do not fit together as a light field: {evidence.reason}"
    if not force:
        raise UserError(
            f"{source.path}: as {source.rows}x{source.cols} views of layout {source.layout}, {why}",
            "give the folder of one scene, or one of the pictures; `lfpipe scene pack --force` opens it all the same",
        )
    return attrs.evolve(source, doubt="; ".join(filter(None, (source.doubt, why))))
