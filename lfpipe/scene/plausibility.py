"""Checks quickly, on a few small pictures, whether they form a light field, before all of them are packed.

Pictures are refused where views between two others are predicted badly from these and no disparity explains the flow (it must be
equal to both neighbours, along the line of cameras), or where they change otherwise than by a camera that moves sideways: in
focus or size. Thresholds lie between 211 disturbed and drawn light fields (at least 0.38 explained and 30 dB, or
0.64 and 24 dB) and 40 made sets that are none (focus stacks with and without breathing, refocused pictures, walks around a box,
portraits, clips, zooms, turns, exposures), of which 37 are refused.
"""

from collections.abc import Callable

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.scene.optical_flow import (
    Grey,
    displaced,
    flow,
    grey_views,
    present_lines,
    returned_flow,
    robust_fit,
    textured,
)
from lfpipe.scene.source import SceneSource

_SMALLEST_PX = 48  # side of views: the flow needs some of its patches
_POOR_DB, _EXPLAINED = (
    26.0,
    0.6,
)  # of views between two others, and share of their detail that one disparity explains
_UNEXPLAINED = 0.15  # share below which they do not fit together whatever their quality
_FINE_DB, _FINE_SHARE = 30.0, 0.7  # of the middle of all lines: enough to skip other views
_LOOSE_PX, _LOOSE_SHARE = 1.0, 0.2  # tolerance of the flow
_STILL_PX = 1.0  # motion that is none
_OFF_PX = 0.5  # from a common motion: what is off by more is near, and counts less
_REFOCUSED = 4.0  # ratio of the sharpest to the least sharp picture of a block, in a focal stack
_ROUND = 1.3  # ratio of motion left in the two directions: below it, there is no direction
_REACH, _FEWEST_POINTS = 8, 100  # views from the middle; pixels to fit motion to
_BLOCKS = 8  # along the shorter side
_SHORTEST_CIRCLE, _FEWEST_PX, _STAYS = (
    8,
    200,
    0.5,
)  # views; pixels that move between them; share of these seen half-way round


@attrs.frozen
class Evidence:
    """held_out_db: PSNR of views predicted from two neighbours, median. explained: share of textured pixels whose flow one
    disparity explains. change: how the pictures change otherwise than by a camera that moves sideways, "" for nothing."""

    held_out_db: float
    explained: float
    change: str = ""

    @property
    def reason(self) -> str:
        """Why the pictures are no light field; "" if they may be one."""
        if self.change:
            return self.change
        if self.explained < _UNEXPLAINED or (
            self.held_out_db < _POOR_DB and self.explained < _EXPLAINED
        ):
            return (
                f"quality when predicting views from their neighbours {self.held_out_db:.0f} dB, and one disparity explains "
                f"the motion of {self.explained:.0%} of the detail"
            )
        return ""

    @classmethod
    def median(cls, samples: list["Evidence"], change: str = "") -> "Evidence":
        """What some samples say together."""
        held_out, explained = zip(
            *((sample.held_out_db, sample.explained) for sample in samples), strict=True
        )
        return cls(float(np.median(held_out)), float(np.median(explained)), change)


def _motion(a: Grey, b: Grey) -> tuple[float, str] | None:
    """Motion between two views, px at the edge of the picture, and what changes more than the viewpoint does, "" for nothing;
    None if too little is in both views."""
    ahead, confirmed = returned_flow(a, b)
    sure = confirmed & textured(a)
    if np.count_nonzero(sure) < _FEWEST_POINTS:
        return None
    y, x = np.nonzero(sure)
    half = a.shape[1] / 2
    x, y = (x - half) / half, (y - a.shape[0] / 2) / half
    one, none = np.ones_like(x), np.zeros_like(x)
    values = ahead[sure].T.ravel().astype(np.float64)
    matrix = np.concatenate([np.stack([one, none, x, -y], 1), np.stack([none, one, y, x], 1)])
    fit = robust_fit(matrix, values, _OFF_PX)
    # A plane that recedes moves along the line of cameras only; size changes along both axes alike.
    wider, taller = (
        robust_fit(np.stack([x, y, one], 1), axis, _OFF_PX)[k]
        for k, axis in enumerate(values.reshape(2, -1))
    )
    size_px = min(abs(wider), abs(taller)) if wider * taller > 0 else 0.0
    left_px = np.ptp(
        np.percentile((values - matrix @ fit).reshape(2, -1), (5, 95), axis=1), axis=0
    )  # along x and y
    shift_px = float(np.hypot(*fit[:2]))
    parallax_px = max(shift_px, float(left_px.max()))
    if size_px > max(_STILL_PX, parallax_px):
        return (
            parallax_px,
            "the pictures differ in size, as when focus breathes, the lens zooms or the camera comes nearer",
        )
    if left_px.min() > _STILL_PX and left_px.max() < _ROUND * left_px.min() > 2 * shift_px:
        return parallax_px, "what moves, moves in no direction"
    return parallax_px, ""


def _change(views: list[Grey], every: list[Grey]) -> str:
    """How the views of a line change otherwise than by a camera that moves sideways; "" for nothing. every: some of the whole
    grid."""
    middle = len(views) // 2
    motions = [
        _motion(views[middle], views[min(len(views) - 1, middle + away)]) for away in (1, _REACH)
    ]
    if change := next((motion[1] for motion in motions if motion is not None and motion[1]), ""):
        return change
    still = all(motion is not None and motion[0] < _STILL_PX for motion in motions)
    if still and (ratio := _refocused(every)) > _REFOCUSED:
        return f"their focus or exposure differs (sharpness by a factor of {ratio:.0f}), their viewpoint does not"
    return ""


def _pair(a: Grey, b: Grey) -> Evidence:
    """As `_triple`, for two views: one predicted from the other, and the share of its detail found there."""
    (ahead, confirmed), detail = returned_flow(a, b), textured(a)
    explained = float(confirmed[detail].mean()) if detail.any() else 1.0
    return Evidence(cv2.PSNR(displaced(b, ahead), a), explained)


def _unsteady(
    x: NDArray[np.intp], y: NDArray[np.intp], motion_px: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Motion of pixels, float32 (n,), without that of a hand: its least-squares fit by a shift, a turn and a zoom."""
    places = np.stack((np.ones(len(x)), x, y), axis=1).astype(np.float32)
    return np.asarray(
        motion_px - places @ np.linalg.lstsq(places, motion_px, rcond=None)[0], np.float32
    )


def _triple(before: Grey, middle: Grey, after: Grey) -> Evidence:
    """PSNR of the middle view predicted from the others, and the share of its detail that one disparity explains."""
    half = flow(before, after) * np.float32(0.5)
    sideways = float(np.abs(half[..., 0]).mean()) >= float(np.abs(half[..., 1]).mean())
    half[..., 1 if sideways else 0] = 0
    predicted = (displaced(before, -half).astype(np.float32) + displaced(after, half)) / 2
    edge = max(1, min(middle.shape) // 20)
    inner = slice(edge, -edge), slice(edge, -edge)
    held_out = cv2.PSNR(predicted[inner], middle[inner].astype(np.float32))
    detail = textured(middle)
    if not detail.any():
        return Evidence(held_out, 1.0)
    to_before, to_after = (flow(middle, other)[detail] for other in (before, after))
    y, x = np.nonzero(detail)
    along, beside = (to_after[:, k] for k in ((0, 1) if sideways else (1, 0)))
    off = np.hypot(*(_unsteady(x, y, (to_before + to_after)[:, k]) for k in (0, 1)))
    loose = _LOOSE_PX + _LOOSE_SHARE * np.abs(along)
    explained = float(((off < loose) & (np.abs(_unsteady(x, y, beside)) < loose)).mean())
    return Evidence(held_out, explained)


def _refocused(views: list[Grey]) -> float:
    """Median over textured blocks of the sharpest over the least sharp picture; 1 if all blocks are sharpest in the same one."""
    side = max(8, min(views[0].shape) // _BLOCKS)
    sharp = []
    for view in views:
        detail = np.square(cv2.Laplacian(view, cv2.CV_32F, ksize=3))
        sharp.append(
            cv2.resize(
                detail, (view.shape[1] // side, view.shape[0] // side), interpolation=cv2.INTER_AREA
            ).ravel()
        )
    blocks = np.stack(sharp)
    use = blocks.max(axis=0) > max(30.0, float(np.median(blocks.max(axis=0))))
    if use.sum() < 4:
        return 1.0
    best, ratio = (
        blocks[:, use].argmax(axis=0),
        blocks[:, use].max(axis=0) / (blocks[:, use].min(axis=0) + 5.0),
    )
    return (
        float(np.median(ratio))
        if len(np.unique(best)) > 1 and np.bincount(best).max() < 0.8 * len(best)
        else 1.0
    )


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
    stays = float(returned_flow(first, middle)[1][detail][moving].mean())
    return comes > _EXPLAINED and stays < _STAYS


def examine(source: SceneSource) -> Evidence | None:
    """Evidence from a few small views; None if there are too few, or they are too small."""
    if min(source.height_px, source.width_px) < _SMALLEST_PX:
        return None
    grey: Callable[[int, int], Grey] = grey_views(source)
    lines = [line for line in present_lines(source) if len(line) >= 3]
    if not lines:
        pairs = [
            _pair(grey(*line[0]), grey(*line[1]))
            for line in present_lines(source)
            if len(line) == 2
        ]
        return Evidence.median(pairs) if pairs else None
    triples = [_triple(*(grey(*line[k + len(line) // 2]) for k in (-1, 0, 1))) for line in lines]
    if any(triple.held_out_db < _FINE_DB or triple.explained < _FINE_SHARE for triple in triples):
        for line in lines:
            for middle in {
                max(1, len(line) // 5),
                min(len(line) - 2, len(line) - 1 - len(line) // 5),
            } - {len(line) // 2}:
                triples.append(_triple(*(grey(*line[middle + k]) for k in (-1, 0, 1))))
    places = [
        (r, c)
        for r in range(source.rows)
        for c in range(source.cols)
        if (r, c) not in source.missing
    ]
    every = [
        grey(*places[k]) for k in sorted({round(p) for p in np.linspace(0, len(places) - 1, 9)})
    ]
    around = [
        line[max(0, len(line) // 2 - _REACH) : len(line) // 2 + _REACH + 1] for line in lines
    ]  # their middle
    changes = [_change([grey(*place) for place in views], every) for views in around]
    change, line = changes[0] if all(changes) else "", lines[0]
    closed = not change and len(lines) == 1 and len(line) >= _SHORTEST_CIRCLE
    if closed and _is_circle(*(grey(*line[k]) for k in (0, 1, len(line) // 2, -1))):
        change = "the last picture follows the first one: a turntable, or a walk around something"
    return Evidence.median(triples, change)


def plausible(source: SceneSource, force: bool) -> SceneSource:
    """The source; if it is no light field, raises UserError, or with `force` adds a doubt."""
    evidence = examine(source)
    if evidence is None or not evidence.reason:
        return source
    why = f"the pictures do not fit together as a light field: {evidence.reason}"
    if not force:
        raise UserError(
            f"{source.path}: as {source.rows}x{source.cols} views of layout {source.layout}, {why}",
            "give the folder of one scene, or one of the pictures; --set scene.force=true opens it all the same",
        )
    return attrs.evolve(source, doubt="; ".join(filter(None, (source.doubt, why))))
