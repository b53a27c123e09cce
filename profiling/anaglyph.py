"""What both eyes see of each anaglyph encoding through simulated glasses: the table of
docs/figures.md. Fused colour, retinal rivalry, and ghosts, on three views of the demo's scene.

`python -m profiling.anaglyph`. Crosstalk follows Woods (2012): leaking luminance over signal
luminance.
"""

import argparse
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.simulator.metrics import GLASS, RED_CYAN, curve, lightness
from lfpipe.bench.simulator.scene import SCENES, scene_of
from lfpipe.render.synthesis.anaglyph import MATRICES, decoded, encode, recipe

Float = NDArray[np.float64]
# (left, right) BGR -> anaglyph BGR
Encoder = Callable[[NDArray[np.uint8], NDArray[np.uint8]], NDArray[np.uint8]]
# XYZ of a screen's red, green and blue at full intensity, without glasses
BARE = np.array([(0.4433, 0.3141, 0.1930), (0.2406, 0.6450, 0.1144), (0.0, 0.1071, 0.9817)])
GREEN_MAGENTA = ("green", "magenta")


def seen_xyz(picture: NDArray[np.uint8], through: Float) -> Float:
    """XYZ, float64 (..., 3), that reaches an eye from uint8 (..., 3) BGR through a matrix of GLASS,
    or BARE.
    """
    return np.asarray(decoded(picture[..., ::-1].astype(np.float64) / 255) @ through.T)


def lab(xyz: Float, white: Float) -> Float:
    """CIELAB, float64 (..., 3). white: XYZ (3,)."""
    f = curve(xyz / white)
    return np.stack(
        [116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])],
        axis=-1,
    )


def fused_error(
    original: NDArray[np.uint8], anaglyph: NDArray[np.uint8], glasses: tuple[str, str] = RED_CYAN
) -> float:
    """Mean CIELAB difference between original and the colour that both eyes fuse from its anaglyph
    (same picture for both eyes).

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
    """Mean difference in L* between the eyes, each relative to its own white (same picture for
    both).
    """
    left, right = (
        lightness(seen_xyz(anaglyph, GLASS[name])[..., 1], GLASS[name][1].sum()) for name in glasses
    )
    return float(np.abs(left - right).mean())


def ghost(
    encode: Encoder, pedestal: float = 0.5, glasses: tuple[str, str] = RED_CYAN
) -> tuple[float, float]:
    """(left, right) leak, in shares; negative if over-corrected.

    An eye's leak is the change of its luminance when the other eye's view goes from black to white,
    over the change when its own view does. The view that does not change stays at pedestal, a code
    value in 0..1.
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


def main() -> None:
    """Prints the table."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    scene = scene_of(SCENES[0])
    places = ((0, 0), (scene.rows // 2, scene.cols // 2), (scene.rows - 1, scene.cols - 1))
    views = [scene.picture(place) for place in places]
    print("| mode | light | ghost compensation | colour, CIELAB | rivalry, L* | ghost |")
    print("|---|---|--:|--:|--:|--:|")
    for name in MATRICES:
        if name == "dubois-amber-blue":  # no spectra of these glasses are available
            continue
        crossed = name.startswith("dubois")
        glasses = GREEN_MAGENTA if name == "dubois-green-magenta" else RED_CYAN
        for light in ("gamma", "linear") if crossed else ("linear",):
            for share in (0.0, 100.0) if light == "linear" else (0.0,):
                how = recipe(name, light, share)
                mixed = [encode(view, view, how) for view in views]
                pairs = zip(views, mixed, strict=True)
                fused = np.mean([fused_error(view, picture, glasses) for view, picture in pairs])
                eye_distance = np.mean([rivalry(picture, glasses) for picture in mixed])
                leaks = ghost(partial(encode, how=how), 0.5, glasses)
                worst = 100 * max(map(abs, leaks))
                metrics = f"{share:.0f} % | {fused:.1f} | {eye_distance:.1f} | {worst:.1f} %"
                print(f"| {name} | {light if crossed else '-'} | {metrics} |")


if __name__ == "__main__":
    main()
