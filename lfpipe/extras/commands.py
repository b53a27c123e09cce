"""Commands and options of the extras: the objects of their entry points in pyproject.toml.

Every `lfpipe` imports this module, so it imports nothing heavy.
"""

from pathlib import Path

import click

from lfpipe.cli.terminal import AddedCommand, AddedOption

KIOSK = AddedCommand(
    "Run an exhibition that starts with the desktop.", "lfpipe.extras.exhibition.kiosk:kiosk"
)
DESKTOP = AddedCommand(
    "Add lfpipe to the desktop's menu.", "lfpipe.extras.exhibition.desktop:desktop"
)
SWEEP = AddedCommand(
    "Run replays, quality and benchmarks over a whole corpus.",
    "lfpipe.extras.sweep.command:sweep",
)
EXPORT = AddedCommand(
    "Write SCENE for other programs and people.", "lfpipe.extras.export.command:export"
)
MAKE = AddedCommand("Make a light field of a clip.", "lfpipe.extras.phone.command:make")
SHARE = AddedCommand(
    "Send the viewer's eyes and head to other programs.", "lfpipe.extras.share.command:share"
)
UP_SHARE = AddedOption(
    (
        click.Option(
            ["--share"],
            multiple=True,
            metavar="TARGET",
            help="Send eyes and head to opentrack:HOST:PORT, osc:HOST:PORT or "
            "lsl[:NAME]; add ?rate=HZ for predicted eyes. Repeatable.",
        ),
    ),
    "lfpipe.extras.share.command:up",
)
UP_KIOSK = AddedOption(
    (
        click.Option(
            ["--kiosk"],
            is_flag=True,
            help="Run an exhibition: full screen, keys ignored; typing its code ends it.",
        ),
        click.Option(
            ["--code-file"],
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="With --kiosk: a file with its code; or set LFPIPE_KIOSK_CODE.",
        ),
        click.Option(
            ["--every", "every_s"],
            type=click.IntRange(1, 86400),
            metavar="SECONDS",
            help="With --kiosk: the time after which the next scene is shown.",
        ),
        click.Option(["--title"], metavar="TEXT", help="With --kiosk: the title on the screen."),
    ),
    "lfpipe.extras.exhibition.kiosk:up",
)
WEB = AddedOption(
    (
        click.Option(
            ["--web"],
            is_flag=False,
            flag_value="",
            metavar="[[HOST]:PORT]",
            help=(
                "Serve a page with charts, pictures and controls on 127.0.0.1, or on HOST. Prints"
                " two URLs: one for control, one view-only, without the camera picture."
            ),
        ),
    ),
    "lfpipe.extras.web.command:monitor",
)
LATENCY = AddedOption(
    (
        click.Option(
            ["--latency"],
            is_flag=True,
            help="Measure the latency of camera and display instead. Point the camera at the"
            " screen, directly or by a hand mirror: a window flickers for 15 s.",
        ),
    ),
    "lfpipe.extras.latency.command:calibrate",
)
