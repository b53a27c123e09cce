"""Constants of the fine flow against its time, on light fields of both kinds of baseline.

    python -m profiling.disparity_choices [SCENE]... --out profiling/results/disparity.md

Each SCENE (a folder, the central 7x7 of its views) and the drawn ones of `drawn_scenes`, grey.
"2x2": the corners of 7x7 views kept; "2nd": every second view of 5x5 kept. Of the views between,
every third and every second one is made with warp2: mean PSNR of luma in studio range, 22 px shaved
off. The time is the thread's CPU time to estimate the disparity of a view, all choices in turn.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.bench.synthesis import left_out, subsample, view_at
from lfpipe.bench.table import shaved, studio_luma
from lfpipe.render.synthesis.compositor import ViewRenderer
from lfpipe.render.synthesis.scoring import psnr_db
from lfpipe.scene import disparity, optical_flow
from lfpipe.scene.disparity import luma
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.open_scene import open_scene
from lfpipe.scene.source import Geometry
from profiling.arguments import existing, parser_of, start
from profiling.drawn_scenes import SCENES, SIDE, views_of

BORDER_PX = 22


@attrs.frozen
class Choice:
    """Settings of the fine flow."""

    descents: int  # of the first pair of neighbours
    descents_near: int  # of the others, if they start from its disparity
    started: bool  # whether they do


CHOICES = {
    "8, then 3 (in use)": Choice(8, 3, True),
    "3 each (22 and 23 November)": Choice(3, 3, False),
    "8 each": Choice(8, 3, False),
    "5, then 3": Choice(5, 3, True),
    "12, then 3": Choice(12, 3, True),
}


def field_of(views: NDArray[np.uint8]) -> LightField:
    """Views, uint8 (rows, cols, 1, h, w), as a light field with disparity still to be estimated."""
    rows, cols, _, height, width = views.shape
    return LightField(
        views=views[None],
        disparity=np.zeros((1, rows, cols, (height + 1) // 2, (width + 1) // 2), np.int8),
        disparity_scale_px=1.0,
        disparity_min_px=0.0,
        disparity_max_px=0.0,
        disparity_source="estimated",
        offsets=np.zeros((rows, cols, 2), np.float32),
        present=np.ones((rows, cols), bool),
        geometry=Geometry(),
        frame_rate_hz=25.0,
        name="",
        method="warp2",
    )


def stored_views(scene: Path) -> NDArray[np.uint8]:
    """The central views of a scene, at most SIDE per side: uint8 (rows, cols, 1, h, w)."""
    stored = np.asarray(open_scene(scene, config.Config().scene).views)[0]
    side = min(SIDE, *stored.shape[:2])
    top, left = ((count - side) // 2 for count in stored.shape[:2])
    inside = stored[top : top + side, left : left + side]
    return np.stack([[luma(np.asarray(view))[None] for view in line] for line in inside])


def score(views: NDArray[np.uint8], step: int, every: int, choice: Choice) -> tuple[float, float]:
    """(dB of the views between every step-th one, CPU ms to estimate the disparity of a view)."""
    spent: list[float] = []
    estimate = disparity.view_disparity
    fine_flow = optical_flow.fine_flow

    def timed(*args: Any) -> Any:
        began = time.thread_time()
        found = estimate(*args)
        spent.append(1000 * (time.thread_time() - began))
        return found

    def flow(a: Any, b: Any, begin: Any = None) -> Any:
        return fine_flow(a, b, begin if choice.started else None)

    with (
        patch.object(disparity, "view_disparity", timed),
        patch.object(disparity, "fine_flow", flow),
        patch.object(optical_flow, "_DESCENTS", choice.descents),
        patch.object(optical_flow, "_DESCENTS_NEAR", choice.descents_near),
    ):
        rows, cols = (range(0, count, step) for count in views.shape[:2])
        field = field_of(views)
        renderer = ViewRenderer(subsample(field, rows, cols), "warp2")
    errors_db = []
    for place, view in list(left_out(field, rows, cols).items())[::every]:
        off = studio_luma(view_at(renderer, place)) - studio_luma(view)
        errors_db.append(psnr_db(float(np.mean(np.square(shaved(off, BORDER_PX))))))
    return float(np.mean(errors_db)), float(np.median(spent))


def rows_of(scenes: list[Path]) -> Iterator[str]:
    heads = [f"{name}: dB, ms" for name in CHOICES]
    yield f"| scene, views kept | {' | '.join(heads)} |"
    yield "|---|" + "--:|" * len(heads)
    gains: dict[str, list[float]] = {name: [] for name in CHOICES}
    asked: list[Path | str] = [*scenes, *SCENES]
    for scene in asked:
        whole = stored_views(scene) if isinstance(scene, Path) else views_of(scene)
        name = scene.name if isinstance(scene, Path) else scene
        kinds = [("2x2", whole, len(whole) - 1, 3)]
        if len(whole) == SIDE:
            kinds.append(("2nd", np.ascontiguousarray(whole[1:6, 1:6]), 2, 2))
        for kind, views, step, every in kinds:
            metrics = {key: score(views, step, every, choice) for key, choice in CHOICES.items()}
            before = metrics["3 each (22 and 23 November)"][0]
            for key, (level_db, _) in metrics.items():
                gains[key].append(level_db - before)
            cells = [f"{level_db:.2f}, {ms:.0f}" for level_db, ms in metrics.values()]
            yield f"| {name}, {kind} | {' | '.join(cells)} |"
    cells = [f"{np.mean(gain):+.2f} ({min(gain):+.2f})" for gain in gains.values()]
    yield f"| mean gain over 3 each (worst) | {' | '.join(cells)} |"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("scenes", metavar="SCENE", nargs="*", type=existing)
    parser.add_argument("--out", type=Path, default=Path("profiling/results/disparity.md"))
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    lines = [
        "# Disparity: error against run time",
        "",
        "`python -m profiling.disparity_choices SCENE...`: steps of descent of the flow to the"
        " first pair of neighbours, and to the others, which start from its disparity.",
        "",
    ]
    for line in rows_of(arguments.scenes):
        print(line, flush=True)
        lines.append(line)
    arguments.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    start(main)
