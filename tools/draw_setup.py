"""Draws the set-up from the side and from above: screen, camera, viewer, glasses, with the distances that matter.

    uv run python tools/draw_setup.py [--out docs/setup.svg]
"""

import argparse
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

SCREEN_MM, DISTANCE_MM, ABOVE_MM, EYES_MM = (530.0, 300.0), 600.0, 170.0, 63.0
SIDE_MM, ABOVE_VIEW_MM = (-190, 790, -290, 290), (-300, 480, -760, 240)  # left, right, bottom, top of the drawings
INK, SOFT, RED, CYAN = "#1b1f24", "#57606a", "#d8343b", "#00a5b5"


Point = tuple[float, float]


def measure(axes: Axes, start: Point, end: Point, text: str, side: Point, ha: str = "center") -> None:
    """A line with arrows at both ends, and its length next to it."""
    axes.annotate("", end, start, arrowprops={"arrowstyle": "<->", "color": SOFT, "lw": 0.9})
    axes.text((start[0] + end[0]) / 2 + side[0], (start[1] + end[1]) / 2 + side[1], text, color=SOFT, fontsize=9, ha=ha)


def from_the_side(axes: Axes) -> None:
    """The screen at x = 0, the viewer at x = DISTANCE_MM, heights from the middle of the screen."""
    half = SCREEN_MM[1] / 2
    axes.add_patch(Rectangle((-18, -half), 18, 2 * half, color="#c9d1d9"))
    axes.add_patch(Rectangle((-40, -half - 60), 60, 10, color="#c9d1d9"))
    axes.add_patch(Rectangle((-14, -half - 60), 10, 60, color="#c9d1d9"))
    axes.add_patch(Rectangle((-16, ABOVE_MM - 12), 26, 24, color=INK))
    axes.text(16, ABOVE_MM + 60, "webcam: both eyes in its picture", fontsize=9, color=INK)
    for angle_mm in (-190, 190):
        axes.plot([10, DISTANCE_MM], [ABOVE_MM, ABOVE_MM - 130 + angle_mm], color=SOFT, lw=0.7, ls=(0, (4, 3)))
    axes.add_patch(Circle((DISTANCE_MM + 70, 0), 95, color="#f1d4b8"))
    axes.add_patch(Rectangle((DISTANCE_MM - 38, -24), 12, 48, color=RED))
    axes.plot([DISTANCE_MM - 26, DISTANCE_MM + 70], [18, 20], color=INK, lw=2)  # the arm of the glasses
    axes.text(DISTANCE_MM + 70, 112, "red/cyan glasses", fontsize=9, color=INK, ha="center")
    axes.plot([0, DISTANCE_MM - 30], [0, 0], color=INK, lw=0.8)
    axes.text(DISTANCE_MM + 80, -212, "eyes level with the\nmiddle of the screen", fontsize=9, color=INK, ha="center")
    measure(axes, (0, -half - 90), (DISTANCE_MM - 22, -half - 90), f"{DISTANCE_MM:.0f} mm: an arm's length", (0, 12))
    measure(axes, (-60, 0), (-60, ABOVE_MM), "camera.\nabove_mm", (-66, -14))
    axes.set_title("from the side", loc="left", fontsize=11, color=INK)


def from_above(axes: Axes) -> None:
    """The screen along x at y = 0, the viewer below it, one line of sight for each eye through a point behind the screen."""
    half, behind = SCREEN_MM[0] / 2, 160.0
    axes.add_patch(Rectangle((-half, 0), 2 * half, 18, color="#c9d1d9"))
    axes.add_patch(Rectangle((-13, 0), 26, 26, color=INK))
    axes.add_patch(Polygon([(-30, behind), (30, behind), (30, behind + 60), (-30, behind + 60)], color="#d7e3c8"))
    axes.text(44, behind + 22, "the scene, behind the screen", fontsize=9, color=INK)
    axes.add_patch(Circle((0, -DISTANCE_MM - 60), 85, color="#f1d4b8"))
    for x, colour in ((-EYES_MM / 2, RED), (EYES_MM / 2, CYAN)):
        axes.plot([x, 0], [-DISTANCE_MM, behind], color=colour, lw=1.1)
        axes.add_patch(Rectangle((x - 28, -DISTANCE_MM - 4), 56, 14, color=colour))
    axes.text(-60, -DISTANCE_MM + 18, "left eye: red", fontsize=9, color=RED, ha="right")
    axes.text(60, -DISTANCE_MM + 18, "right eye: cyan", fontsize=9, color=CYAN)
    measure(axes, (-half, 40), (half, 40), "screen.width_mm", (-half + 8, 10), "left")
    measure(axes, (half + 20, 0), (half + 20, -DISTANCE_MM), "distance, measured\nfrom the eyes", (14, 0), "left")
    measure(axes, (-EYES_MM / 2, -DISTANCE_MM - 34), (EYES_MM / 2, -DISTANCE_MM - 34), f"{EYES_MM:.0f} mm", (0, -46))
    axes.set_title("from above", loc="left", fontsize=11, color=INK)


def main(out: Path) -> None:
    """Writes the drawing; equal code gives an equal file."""
    with mpl.rc_context({"svg.hashsalt": "lfpipe", "font.family": "DejaVu Sans", "svg.fonttype": "path"}):
        figure = Figure(figsize=(11, 5), layout="constrained")
        side, above = figure.subplots(1, 2, width_ratios=[1.05, 1])
        for axes, draw, limits in ((side, from_the_side, SIDE_MM), (above, from_above, ABOVE_VIEW_MM)):
            draw(axes)
            axes.set(aspect="equal", xlim=limits[:2], ylim=limits[2:])
            axes.axis("off")
        figure.savefig(out, metadata={"Date": None, "Creator": "tools/draw_setup.py"})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "setup.svg")
    main(parser.parse_args().out)
