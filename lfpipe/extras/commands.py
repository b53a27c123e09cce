"""What the extras add to the command line: the objects of their entry points in pyproject.toml.

Imports nothing heavy: every `lfpipe` imports it.
"""

from pathlib import Path

import click

from lfpipe.cli.plugged import AddedCommand, AddedOption

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
            help="Run an exhibition: full screen, all keys ignored; typing its code ends it.",
        ),
        click.Option(
            ["--code-file"],
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="With --kiosk: a file with the code that ends it; or set LFPIPE_KIOSK_CODE.",
        ),
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
                "Serve a page with charts, pictures and controls on 127.0.0.1, or on HOST. It"
                " prints two addresses: one for control, one for watching only, without the"
                " camera's picture."
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
            help="Measure the total delay of camera and display, which prediction uses, instead:"
            " turn the camera to the screen, or show it the screen in a hand mirror. A window"
            " flickers for 15 s while the camera watches it.",
        ),
    ),
    "lfpipe.extras.latency.command:calibrate",
)
