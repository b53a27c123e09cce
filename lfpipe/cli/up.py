"""`lfpipe up`: a live session."""

from typing import Any

import click

from lfpipe.cli.options import DURATION, OVERWRITE, PATH, SESSION, with_settings

EXAMPLES = """\b
Examples:
  lfpipe up --demo
  lfpipe up boxes/ flowers/ dino.h5
  lfpipe up boxes/ --display fullscreen --set screen.monitor=1
  lfpipe up --no-picture --share opentrack:127.0.0.1:4242
  lfpipe up boxes/ --camera 'file:me.mp4?loop=1' --display none --duration 20 --trace t.jsonl
"""


@click.command(epilog=EXAMPLES)
@click.argument("scenes", nargs=-1, metavar="[SCENE]...", type=PATH)
@click.option(
    "--camera",
    metavar="SRC",
    help="camera:N, camera:/dev/videoN, file:PATH[?loop=0|1&pace=recorded|max|HZ], demo or mouse.",
)
@click.option(
    "--display",
    metavar="WHERE",
    help="window, fullscreen, none, or file:OUT as .mp4, .avi or .mkv (lossless)."
    "  [default: window]",
)
@DURATION
@click.option("--trace", type=PATH, metavar="FILE", help="Write one JSON line per picture.")
@click.option(
    "--demo",
    is_flag=True,
    help="Use a built-in scene and face.",
)
@OVERWRITE
@click.option("--no-picture", is_flag=True, help="Track the eyes only, without SCENE and window.")
@SESSION
@with_settings
def up(**options: Any) -> int:
    """Show SCENE, a folder or file with a light field, from the position of the viewer's eyes.

    Several scenes, or a folder of scenes, form a playlist: switch with Tab, Page Up and Page Down.
    Press h in the window to list the keys. While a window is open, `lfpipe up SCENE` shows SCENE
    there; --session NAME opens another window.
    """
    from lfpipe.cli.launch import UpArguments, launch

    policy = {"run_policy": options.pop("run_policy")} if "run_policy" in options else {}
    return launch(UpArguments(**options), **policy)
