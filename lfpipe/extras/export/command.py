"""`lfpipe scene export`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from lfpipe.cli.scene import PICTURES, check_picture, opened, write_picture
from lfpipe.cli.terminal import OVERWRITE, PATH, SCENE, Group, Number, print_result, say, with_scene
from lfpipe.config import Config
from lfpipe.extras.export import pictures
from lfpipe.extras.export.page import PageExport, check_page, frame_of
from lfpipe.files.safe_files import check_output, write_output
from lfpipe.scene.lightfield import undecided

Command = Callable[..., Any]
PAIRS = (*PICTURES, ".jps", ".mpo", ".mp4")


@click.group(cls=Group)
def export() -> None:
    """Export SCENE for other programs and people."""


def _out(help_text: str) -> Callable[[Command], Command]:
    out = click.option("-o", "--out", type=PATH, required=True, help=help_text)
    return lambda command: out(OVERWRITE(command))


EYE_DISTANCE = click.option(
    "--apart",
    "eye_distance",
    type=float,
    metavar="VIEWS",
    help="Views between the eyes.  [default: comfortable]",
)


def _seconds(default_s: float) -> Callable[[Command], Command]:
    return click.option(
        "--seconds",
        type=Number(0.1, 600),
        default=default_s,
        show_default=True,
        metavar="S",
        help="Length of the clip, there and back.",
    )


@export.command()
@SCENE
@_out("Picture; _qs8x6a1.00 is appended to its name.")
@click.option("--tiles", default="8x6", show_default=True, metavar="COLSxROWS", help="Tiles.")
@with_scene
def quilt(path: Path, out: Path, overwrite: bool, tiles: str, config: Config) -> None:
    """Write a quilt of views from left to right, for Looking Glass displays."""
    cols, rows = pictures.parse_tiles(tiles)
    check_picture(out, path, True)
    field = opened(path, config)
    name = pictures.quilt_name(out, cols, rows, field.width_px / field.height_px)
    check_picture(name, path, overwrite)
    write_picture(name, pictures.SceneExport(field, config).quilt(cols, rows))


@export.command()
@SCENE
@_out("Picture (.png, .jpg, .jps, .mpo) or clip (.mp4); _sbs or _LR is appended to its name.")
@EYE_DISTANCE
@_seconds(pictures.SWEEP_S)
@with_scene
def pair(
    path: Path,
    out: Path,
    overwrite: bool,
    eye_distance: float | None,
    seconds: float,
    config: Config,
) -> None:
    """Write the views of both eyes, for stereo viewers. MP4 needs the extra media."""
    out = pictures.pair_name(out)
    if out.suffix.lower() == ".mp4":
        _write_clip(path, out, overwrite, "pair", eye_distance, seconds, config)
        return
    check_picture(out, path, overwrite, PAIRS)
    exported = pictures.SceneExport(opened(path, config), config)
    write_output(out, pictures.stereo_file(*exported.eyes(eye_distance), out.suffix.lower()))
    print_result(out)


@export.command()
@SCENE
@_out("Clip (.gif, .mp4).")
@EYE_DISTANCE
@_seconds(pictures.WIGGLE_S)
@with_scene
def wiggle(
    path: Path,
    out: Path,
    overwrite: bool,
    eye_distance: float | None,
    seconds: float,
    config: Config,
) -> None:
    """Write a clip that swings between the views of both eyes: depth without glasses."""
    _write_clip(path, out, overwrite, "wiggle", eye_distance, seconds, config)


@export.command("sweep")
@SCENE
@_out("Clip (.mp4, .gif).")
@_seconds(pictures.SWEEP_S)
@with_scene
def sweep_clip(path: Path, out: Path, overwrite: bool, seconds: float, config: Config) -> None:
    """Write a clip along the middle row, there and back."""
    _write_clip(path, out, overwrite, "sweep", None, seconds, config)


def _write_clip(
    path: Path,
    out: Path,
    overwrite: bool,
    form: str,
    eye_distance: float | None,
    seconds: float,
    config: Config,
) -> None:
    pictures.check_clip(out, round(seconds * pictures.RATE_HZ))
    check_output(out, [path], overwrite)
    exported = pictures.SceneExport(opened(path, config), config)
    pictures.write_clip(out, exported.clip(form, eye_distance, seconds), pictures.RATE_HZ)
    print_result(f"{out}  {out.stat().st_size / 1e6:.2f} MB")


@export.command()
@SCENE
@_out("Page (.html).")
@click.option("--credit", metavar="TEXT", default="", help="Line below the picture.")
@with_scene
def page(path: Path, out: Path, overwrite: bool, credit: str, config: Config) -> None:
    """Write a web page: one file of at most 8 MB that any browser opens.

    Look around by mouse, touch or tilt; a button shows red/cyan. The page loads nothing else.
    """
    check_page(out)
    check_output(out, [path], overwrite)
    field = opened(path, config)
    if undecided(field, config.scene.invert_depth):
        say("warning: near and far may be swapped; compare with --set scene.invert_depth=yes")
    for note in field.manifest.notes:  # as that other files are another scene
        say(f"warning: {note}")
    quilt = PageExport(field, config).write(out, credit)
    print_result(
        f"{out}  {out.stat().st_size / 1e6:.2f} MB, {quilt.rows}x{quilt.cols} views of"
        f" {quilt.width_px}x{quilt.height_px} px"
    )
    if quilt.wanted != (quilt.rows, quilt.cols):
        rows, cols = quilt.wanted
        print_result(
            f"  fewer than the {rows}x{cols} views of a smooth picture: it would be too large"
        )
    if field.frames > 1:
        print_result(f"  the first of {field.frames} frames")
    print_result(f"  {frame_of(out, field.name, quilt)}")
