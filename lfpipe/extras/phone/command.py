"""`lfpipe scene make`."""

from pathlib import Path

import click

from lfpipe.cli.scene import opened
from lfpipe.cli.terminal import PATH, print_result, progress, with_config
from lfpipe.config import Config
from lfpipe.extras.phone.maker import make_in_child


@click.command()
@click.argument("path", metavar="CLIP", type=PATH)
@click.option(
    "-o", "--out", type=PATH, help="New folder for the views.  [default: CLIP-views beside CLIP]"
)
@with_config
def make(path: Path, out: Path | None, config: Config) -> None:
    """Make a light field of one row from CLIP, a video or a folder of pictures from a camera that
    slid sideways.
    """
    with progress() as bar:
        folder = out or path.with_name(f"{path.stem}-views")
        slide = make_in_child(path, folder, bar)
    print_result(
        f"{slide.views} views of {slide.width_px}x{slide.height_px} px, chosen from"
        f" {slide.frames} pictures"
    )
    print_result(
        f"  parallax    {slide.spread_px:.0f} px between outermost views,"
        f" {slide.residual_px:.2f} px vertical error (95 %)"
    )
    hint = "certain" if slide.order_sure else "press d in the window if the depth looks inverted"
    print_result(f"  direction   {slide.order} ({hint})")
    opened(folder, config)
    print_result(str(folder))
