"""Subject: anaglyph encodings through simulated glasses. Fused colour, rivalry, ghosts, and time."""

from collections.abc import Iterator
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.colour_metric import GREEN_MAGENTA, RED_CYAN, fused_error, ghost, rivalry
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Candidate, Chart, Figure, Prepared, Samples, Skipped, Subject
from lfpipe.bench.stats import time_figures, times_ms
from lfpipe.config import Render
from lfpipe.render.anaglyph import MATRICES, Mixer, encode, recipe
from lfpipe.scene.lightfield import LightField

SIDE_PX = 1024
MEGAPIXELS = SIDE_PX * SIDE_PX / 1e6
TURN_PICTURES = 8


def view_bgr(field: LightField, row: int, col: int) -> NDArray[np.uint8]:
    """A stored view, uint8 (height, width, 3) BGR."""
    view = np.asarray(field.views)[0, row, col]
    return np.ascontiguousarray(np.broadcast_to(view[::-1], (3, *view.shape[1:])).transpose(1, 2, 0))


def candidates(inputs: Inputs) -> Iterator[Candidate | Skipped]:
    """Encodings x light x ghost compensation."""
    field = inputs.field
    if field.channels == 1:
        yield Skipped("saturated colours", "a grey scene: the error is of grey pictures")
    yield Skipped("dubois-amber-blue", "no spectra of amber and blue glasses are available")
    step = max(1, min(field.height_px, field.width_px) // (128 if inputs.quick else 256))
    indices = {(0, 0), (field.rows // 2, field.cols // 2), (field.rows - 1, field.cols - 1)}
    views = [view_bgr(field, *index)[::step, ::step] for index in sorted(indices)]
    usual = Render()
    for name in MATRICES:
        if name == "dubois-amber-blue":
            continue
        crossed = name.startswith("dubois")
        for light in ("gamma", "linear") if crossed else ("linear",):
            for share in (0.0, 50.0, 100.0) if light == "linear" else (0.0,):
                knob = (f"{light} light" if crossed else "") + (f"{', ' if crossed else ''}ghost -{share:.0f} %" if share else "")
                paper = name == "colour" and not share
                used = (name, light, share) == (usual.anaglyph, usual.light, float(usual.ghost_compensation))
                yield Candidate(name, knob or "plain", partial(_prepare, views, name, light, share), paper, used)


def _prepare(views: list[NDArray[np.uint8]], name: str, light: str, share: float) -> Prepared:
    how = recipe(name, light, share)
    glasses = GREEN_MAGENTA if name == "dubois-green-magenta" else RED_CYAN
    rng, side = np.random.default_rng(0), (SIDE_PX, SIDE_PX)
    noise = (cv2.GaussianBlur(rng.integers(0, 256, side, dtype=np.uint8), (0, 0), 5) for _ in how.planes)
    mixer, planes, out = Mixer(how, *side), [np.asarray(plane, np.uint8) for plane in noise], np.zeros((*side, 3), np.uint8)

    def errors() -> Samples:
        mixed = [encode(view, view, how) for view in views]
        return {
            "fused": [fused_error(view, out, glasses) for view, out in zip(views, mixed, strict=True)],
            "rivalry": [round(rivalry(out, glasses), 9) for out in mixed],
            "ghost": [100 * max(abs(leak) for leak in ghost(lambda a, b: encode(a, b, how), 0.5, glasses))],
        }

    def turn() -> dict[str, float]:
        return time_figures(times_ms(lambda: mixer.mix(planes, out), TURN_PICTURES), "ms_mp", 1 / MEGAPIXELS)

    return Prepared(errors, turn)


SUBJECT = Subject(
    "anaglyph",
    "Anaglyph encodings",
    "What both eyes see through simulated glasses, for views of the scene: error of the fused colour, difference in lightness"
    " between the eyes, and the other eye's light on mid grey.",
    (
        Figure("fused", "error of the fused colour", "CIELAB", "mean"),
        Figure("rivalry", "rivalry between the eyes", "L*", "mean"),
        Figure("ghost", "ghost of the other eye on grey", "% of its light", "max"),
        Figure("time_ms_mp", "time per megapixel, p50", "ms"),
        Figure("time_p95_ms_mp", "time per megapixel, p95", "ms"),
    ),
    tuple(
        Chart(f"anaglyph-{name}", f"{title} against time", "time_ms_mp", y)
        for name, title, y in (
            ("colour", "Error of colour", "fused"),
            ("rivalry", "Rivalry", "rivalry"),
            ("ghost", "Ghost", "ghost"),
        )
    ),
    candidates,
    paper="colour: red of the left view, green and blue of the right",
    needs=("scene",),
    budget_s=(3.0, 30.0),
)
