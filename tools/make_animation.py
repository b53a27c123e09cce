"""Draws the moving picture of README: the demo's scene on the screen while the viewer's head moves, docs/look_around.gif.

    uv run python tools/make_animation.py [--out docs/look_around.gif] [--scene SCENE]

Left the red/cyan picture on the screen, right what the two eyes fuse it to; below, the head moves from side to side.
"""

import argparse
import math
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw

import lfpipe

FRAMES, STEP_MS = 20, 100  # two seconds for a head to go and come back, as people do
PANEL_PX, FLOOR_PX = 300, 64  # width of a panel, height of the floor with the head: together small enough for under 1 MB
COLOURS = 80  # of the palette: more are not seen in a picture of this size
INK, FLOOR, SKIN, RED, CYAN = (87, 96, 106), (246, 248, 250), (241, 212, 184), (216, 52, 59), (0, 165, 181)


def panel(picture: np.ndarray) -> Image.Image:
    """A BGR picture at the width of a panel."""
    height = round(picture.shape[0] * PANEL_PX / picture.shape[1])
    return Image.fromarray(cv2.resize(picture, (PANEL_PX, height), interpolation=cv2.INTER_AREA)[..., ::-1])


def draw_head(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
    """A head from above with its glasses, the nose towards the screen."""
    draw.ellipse((x - 22, y - 14, x + 22, y + 22), fill=SKIN)
    draw.polygon([(x - 4, y - 13), (x, y - 19), (x + 4, y - 13)], fill=SKIN)
    draw.rectangle((x - 20, y - 13, x - 4, y - 8), fill=RED)
    draw.rectangle((x + 4, y - 13, x + 20, y - 8), fill=CYAN)


def frame(field: lfpipe.LightField, phase: float) -> Image.Image:
    """One picture of the animation. phase: 0 to 1, once from side to side and back."""
    reach, between = (field.cols - 1) / 2 - 1, 1.0  # columns the head moves by, and the eyes are apart
    col = (field.cols - 1) / 2 + reach * math.sin(2 * math.pi * phase)
    row = (field.rows - 1) / 2
    screen = panel(lfpipe.render_anaglyph(field, (row, col - between), (row, col + between)))
    fused = panel(lfpipe.render_view(field, row, col))
    canvas = Image.new("RGB", (2 * PANEL_PX + 12, screen.height + FLOOR_PX), FLOOR)
    canvas.paste(screen, (0, 0))
    canvas.paste(fused, (PANEL_PX + 12, 0))
    draw = ImageDraw.Draw(canvas)
    for left, text in ((0, "on the screen"), (PANEL_PX + 12, "through the glasses")):
        draw.text((left + 6, screen.height + FLOOR_PX - 16), text, fill=INK)
    draw_head(draw, PANEL_PX / 2 + 0.3 * PANEL_PX * math.sin(2 * math.pi * phase), screen.height + 26)
    return canvas


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "look_around.gif")
    parser.add_argument("--scene", help="the demo's without it")
    options = parser.parse_args()
    field = lfpipe.open_scene(options.scene)
    sample = frame(field, 0.0)
    for index, colour in enumerate((SKIN, RED, CYAN, INK)):  # small areas, which a palette by frequency leaves out
        sample.paste(colour, (index * 60, sample.height - FLOOR_PX, index * 60 + 60, sample.height))
    palette = sample.quantize(COLOURS)
    pictures = [frame(field, index / FRAMES).quantize(palette=palette, dither=Image.Dither.NONE) for index in range(FRAMES)]
    pictures[0].save(options.out, save_all=True, append_images=pictures[1:], duration=STEP_MS, loop=0, optimize=True)
    print(f"{options.out}: {options.out.stat().st_size / 1e3:.0f} kB, {pictures[0].width}x{pictures[0].height}")


if __name__ == "__main__":
    main()
