"""Subject: anaglyph encodings through simulated glasses. Fused colour, retinal rivalry, ghosts, and time.

The matrices turn linear RGB of an ordinary LCD into the XYZ that reaches an eye, without and with each glass. They integrate
spectra of display and filters (digitised in the public project angler.js, after Woods' measurements) over the CIE 1931 observer.
The display's white is D65 with Y = 1. Crosstalk follows Woods (2012): leaking luminance over signal luminance.
"""

from collections.abc import Callable, Iterator
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Figures
from lfpipe.bench.runner import Candidate, Offer, Turn, time_ms
from lfpipe.config import Render
from lfpipe.render.anaglyph import MATRICES, Mixer, decoded, encode, recipe
from lfpipe.scene.lightfield import LightField

SIDE_PX, TURN_PICTURES = 1024, 8  # of timed pictures, about a megapixel; a turn takes some ms
Float = NDArray[np.float64]
Encoder = Callable[
    [NDArray[np.uint8], NDArray[np.uint8]], NDArray[np.uint8]
]  # (left, right) BGR -> anaglyph BGR

# XYZ of a screen's red, green and blue at full: without a glass, and through each
BARE = np.array([(0.4433, 0.3141, 0.1930), (0.2406, 0.6450, 0.1144), (0.0, 0.1071, 0.9817)])
GLASS = {
    "red": np.array([(0.1909, 0.0259, 0.0001), (0.0922, 0.0135, 0.0001), (0.0, 0.0, 0.0)]),
    "cyan": np.array([(0.0010, 0.0778, 0.1070), (0.0009, 0.2381, 0.0658), (0.0, 0.0744, 0.5735)]),
    "green": np.array([(0.0006, 0.0429, 0.0044), (0.0006, 0.1266, 0.0170), (0.0, 0.0052, 0.0026)]),
    "magenta": np.array(
        [(0.2437, 0.0309, 0.0512), (0.1174, 0.0153, 0.0043), (0.0, 0.0044, 0.2621)]
    ),
}
RED_CYAN = ("red", "cyan")
GREEN_MAGENTA = ("green", "magenta")


def seen_xyz(picture: NDArray[np.uint8], through: Float) -> Float:
    """XYZ, float64 (..., 3), that reaches an eye from uint8 (..., 3) BGR through a matrix of GLASS, or BARE."""
    light: Float = decoded(picture[..., ::-1].astype(np.float64) / 255) @ through.T
    return light


def _curve(ratio: Float) -> Float:
    return np.where(
        ratio > (6 / 29) ** 3, np.cbrt(np.maximum(ratio, 0.0)), ratio * (29 / 6) ** 2 / 3 + 4 / 29
    )


def lightness(luminance: Float, white: float) -> Float:
    """CIE L*, 0..100 for luminance up to white."""
    value: Float = 116 * _curve(luminance / white) - 16
    return value


def lab(xyz: Float, white: Float) -> Float:
    """CIELAB, float64 (..., 3). white: XYZ (3,)."""
    f = _curve(xyz / white)
    return np.stack(
        [116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])],
        axis=-1,
    )


def fused_error(
    original: NDArray[np.uint8], anaglyph: NDArray[np.uint8], glasses: tuple[str, str] = RED_CYAN
) -> float:
    """Mean CIELAB difference between original and the colour that both eyes fuse from its anaglyph (same picture for both eyes).

    Each eye is adapted to its own white; the fused colour is the mean of the two.
    """
    left, right = (GLASS[name] for name in glasses)
    white_left, white_right = left.sum(axis=1), right.sum(axis=1)
    fused = (
        seen_xyz(anaglyph, left) / white_left[1] + seen_xyz(anaglyph, right) / white_right[1]
    ) / 2
    fused_white = (white_left / white_left[1] + white_right / white_right[1]) / 2
    difference = lab(fused, fused_white) - lab(seen_xyz(original, BARE), BARE.sum(axis=1))
    return float(np.linalg.norm(difference, axis=-1).mean())


def rivalry(anaglyph: NDArray[np.uint8], glasses: tuple[str, str] = RED_CYAN) -> float:
    """Mean difference in L* between the eyes, each relative to its own white (same picture for both)."""
    left, right = (
        lightness(seen_xyz(anaglyph, GLASS[name])[..., 1], GLASS[name][1].sum()) for name in glasses
    )
    return float(np.abs(left - right).mean())


def ghost(
    encode: Encoder, pedestal: float = 0.5, glasses: tuple[str, str] = RED_CYAN
) -> tuple[float, float]:
    """(left, right) leak, in shares; negative if over-corrected.

    An eye's leak is the change of its luminance when the other eye's view goes from black to white, over the change when its own
    view does. The view that does not change stays at pedestal, a code value in 0..1.
    """

    def luminance(eye: int, own: float, other: float) -> float:
        views = [np.full((1, 1, 3), round(value * 255), np.uint8) for value in (own, other)]
        return float(
            seen_xyz(encode(*views[:: 1 if eye == 0 else -1]), GLASS[glasses[eye]])[0, 0, 1]
        )

    left, right = (
        (luminance(eye, pedestal, 1.0) - luminance(eye, pedestal, 0.0))
        / (luminance(eye, 1.0, pedestal) - luminance(eye, 0.0, pedestal))
        for eye in (0, 1)
    )
    return left, right


def view_bgr(field: LightField, row: int, col: int) -> NDArray[np.uint8]:
    """A stored view, uint8 (height, width, 3) BGR."""
    view = np.asarray(field.views)[0, row, col]
    return np.ascontiguousarray(
        np.broadcast_to(view[::-1], (3, *view.shape[1:])).transpose(1, 2, 0)
    )


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Encodings x light x ghost compensation."""
    field, usual = inputs.field, Render()
    if field.channels == 1:
        yield "saturated colours: a grey scene: the error is of grey pictures"
    yield "dubois-amber-blue: no spectra of amber and blue glasses are available"
    step = max(1, min(field.height_px, field.width_px) // (128 if inputs.quick else 256))
    indices = {(0, 0), (field.rows // 2, field.cols // 2), (field.rows - 1, field.cols - 1)}
    views = [view_bgr(field, *index)[::step, ::step] for index in sorted(indices)]
    for name in MATRICES:
        if name == "dubois-amber-blue":
            continue
        crossed = name.startswith("dubois")
        for light in ("gamma", "linear") if crossed else ("linear",):
            for share in (0.0, 50.0, 100.0) if light == "linear" else (0.0,):
                knob = (
                    ", ".join(
                        [f"{light} light"] * crossed + [f"ghost -{share:.0f} %"] * bool(share)
                    )
                    or "plain"
                )
                used = (name, light, share) == (
                    usual.anaglyph,
                    usual.light,
                    float(usual.ghost_compensation),
                )
                yield Candidate(
                    name,
                    knob,
                    partial(_prepare, views, name, light, share),
                    name == "colour" and not share,
                    used,
                )


def _prepare(
    views: list[NDArray[np.uint8]], name: str, light: str, share: float
) -> tuple[Figures, Turn]:
    how = recipe(name, light, share)
    glasses = GREEN_MAGENTA if name == "dubois-green-magenta" else RED_CYAN
    rng, side = np.random.default_rng(0), (SIDE_PX, SIDE_PX)
    noise = (
        cv2.GaussianBlur(rng.integers(0, 256, side, dtype=np.uint8), (0, 0), 5) for _ in how.planes
    )
    mixer, planes, out = (
        Mixer(how, *side),
        [np.asarray(plane, np.uint8) for plane in noise],
        np.zeros((*side, 3), np.uint8),
    )
    mixed = [encode(view, view, how) for view in views]
    figures = {
        "fused": float(
            np.mean(
                [
                    fused_error(view, picture, glasses)
                    for view, picture in zip(views, mixed, strict=True)
                ]
            )
        ),
        "rivalry": round(float(np.mean([rivalry(picture, glasses) for picture in mixed])), 9),
        "ghost": 100
        * max(abs(leak) for leak in ghost(lambda a, b: encode(a, b, how), 0.5, glasses)),
    }
    megapixels = SIDE_PX**2 / 1e6
    return figures, lambda: {
        "time_ms_mp": time_ms(lambda: mixer.mix(planes, out), TURN_PICTURES) / megapixels
    }
