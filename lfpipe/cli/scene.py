"""`lfpipe scene`: packs, lists, inspects and plans light fields."""

import json
import math
from pathlib import Path

import attrs
import click
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.cli.terminal import (
    JSON,
    OVERWRITE,
    PATH,
    SCENE,
    ExtensibleGroup,
    filled,
    print_result,
    progress,
    with_config,
    with_scene,
)
from lfpipe.config import Config
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.errors import UserError
from lfpipe.files.safe_files import check_output, write_output
from lfpipe.host.files import is_dir
from lfpipe.render.plan import make_plan, planned_levels
from lfpipe.render.synthesis.compositor import ViewRenderer
from lfpipe.scene.analysis import describe_folder
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import ask_manifest, cache_dir, open_scene, packed, packs, remove
from lfpipe.scene.packer import expected_field, facts, lines
from lfpipe.supervisor.process_table import SCORER

PICTURES = (".png", ".jpg", ".jpeg")


def opened(path: Path | None, config: Config) -> LightField:
    """Opens the scene, or the demo; packs it first if necessary, with a progress bar.

    Raises UserError.
    """
    with progress() as bar:
        return open_scene(path, config.scene, bar, scorer=SCORER)


def check_picture(
    path: Path, scene: Path, overwrite: bool, kinds: tuple[str, ...] = PICTURES
) -> None:
    """Raises UserError if a command that reads scene must not write a picture to path.

    Called before any work.
    """
    if path.suffix.lower() not in kinds:
        raise UserError(
            f"{path}: not {', '.join(kinds[:-1])} or {kinds[-1]}", "use for example view.png"
        )
    check_output(path, [scene], overwrite)


def write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Writes a BGR picture to a path that `check_picture` allows. Raises UserError."""
    suffix = ".png" if path.suffix.lower() == ".png" else ".jpg"
    _, data = cv2.imencode(suffix, picture)
    write_output(path, data.tobytes())
    print_result(path)


@click.group(cls=ExtensibleGroup)
def scene() -> None:
    """Pack, list and inspect light fields."""


@scene.command()
@SCENE
@with_scene
@JSON
def pack(path: Path, as_json: bool, config: Config) -> None:
    """Pack SCENE into the cache, as `lfpipe up` does automatically."""
    field = opened(path, config)
    if as_json:
        session = {"pack": field.folder, "needs_tracking": make_plan(field, config).needs_tracking}
        print_result(json.dumps({**session, **attrs.asdict(field.manifest)}))
    else:
        print_result(field.folder)


@scene.command("list")
@with_config
@JSON
def list_packs(as_json: bool, config: Config) -> None:
    """List the packs in the cache."""
    cached = packs(config.scene)
    if as_json:
        keys = ("name", "source", "layout", "rows", "cols", "frames", "height", "width", "created")
        rows = [
            {
                "key": pack.folder.name,
                "bytes": pack.size_bytes,
                **{key: getattr(pack.manifest, key, None) for key in keys},
            }
            for pack in cached
        ]
        print_result(json.dumps({"cache": str(cache_dir(config.scene)), "packs": rows}))
        return
    for pack in cached:
        what = "damaged"
        if about := pack.manifest:
            grid = f"{about.rows}x{about.cols} of {about.width}x{about.height}"
            what = f"{grid}\n    {about.source}"
        print_result(f"{pack.folder.name} {pack.size_bytes / 1e6:8.1f} MB  {what}")
    size_mb = sum(pack.size_bytes for pack in cached) / 1e6
    print_result(f"{len(cached)} packs, {size_mb:.1f} MB in {cache_dir(config.scene)}")


@scene.command()
@click.argument("keys", nargs=-1, metavar="[KEY|NAME]...")
@click.option("--all", "everything", is_flag=True, help="Remove every pack.")
@with_config
def clean(keys: tuple[str, ...], everything: bool, config: Config) -> None:
    """Remove packs by key or name; without KEY, remains of killed runs and other versions. Packs
    that a session shows are kept.
    """
    cached = packs(config.scene)
    if unknown := sorted(set(keys).difference(*(pack.names for pack in cached))):
        raise UserError(
            f"{', '.join(unknown)}: no such pack", "see keys and names with `lfpipe scene list`"
        )
    chosen = [pack for pack in cached if everything or pack.names & set(keys)]
    removed_bytes = [pack.size_bytes for pack in chosen if remove(pack.folder)]
    for pack in chosen:
        if is_dir(pack.folder):
            print_result(f"kept, in use or with other files: {pack.folder.name}")
    leftovers = sum(remove(pack.folder) for pack in packs(config.scene) if pack.manifest is None)
    count = "1 pack" if len(removed_bytes) == 1 else f"{len(removed_bytes)} packs"
    print_result(f"removed {count}, {sum(removed_bytes) / 1e6:.1f} MB, and {leftovers} leftovers")


@scene.command()
@SCENE
@with_scene
@JSON
def plan(path: Path, as_json: bool, config: Config) -> None:
    """Show the work that SCENE does not need, and its quality levels: error against run time.

    A video that is not packed yet is examined only: then the method is that of most scenes.
    """
    field = packed(path, config.scene, complete=True)
    if field is None:
        with progress() as bar:
            manifest = ask_manifest(path, config.scene, bar)
        field = expected_field(manifest) if manifest.frames > 1 else opened(path, config)
    plan = make_plan(field, config)
    picture_px, levels = planned_levels(field, config, plan.method)
    if as_json:
        sizes = {"picture_px": picture_px, "levels": [attrs.asdict(level) for level in levels]}
        print_result(json.dumps({"scene": field.name, **attrs.asdict(plan), **sizes}))
        return
    needs = [
        name for name in ("tracking", "rows", "warp", "depth") if getattr(plan, f"needs_{name}")
    ]
    print_result(
        f"{field.name}: {field.rows}x{field.cols} views, method {plan.method}, needs"
        f" {', '.join(needs) or 'nothing'}"
    )
    for item in plan.left_out:
        print_result(f"  left out: {item.what}")
        print_result(filled(item.why, "    because "))
        print_result(filled(item.saves, "    saves   "))
    if not plan.left_out:
        print_result("  nothing can be left out")
    if levels:
        width, height = picture_px
        print_result(f"  levels of quality of a picture of {width}x{height}:")
        print_result("    method    width     error       CPU")
    for level in levels:
        cost_ms = level.ns_per_px * math.prod(picture_px) / 1e6
        print_result(
            f"    {level.method:8}{level.size:6.0%}{level.error:7.2f} /255{cost_ms:7.2f} ms"
        )


@scene.command()
@SCENE
@with_scene
@JSON
def info(path: Path, as_json: bool, config: Config) -> None:
    """Show SCENE's layout, grid, order of views, disparity and geometry."""
    field = packed(path, config.scene, complete=True)
    manifest = field.manifest if field else ask_manifest(path, config.scene)
    pack = field.folder if field else ""
    if as_json:
        print_result(json.dumps(facts(manifest, pack)))
    else:
        for line in lines(manifest, pack):
            print_result(filled(line[14:], line[:14]))


@scene.command()
@click.argument("folder", metavar="FOLDER", type=PATH)
@with_scene
def describe(folder: Path, config: Config) -> None:
    """Write lightfield.toml to FOLDER, which describes the order of its views.

    It contains --layout, --grid, --flip and each --set scene.KEY=VALUE, for example
    --set scene.invert_depth=yes. The file takes precedence over detection.
    """
    if not is_dir(folder):
        raise UserError(f"{folder}: no folder", "specify the folder of the views")
    manifest = ask_manifest(folder, config.scene)
    print_result(describe_folder(folder, config.scene))
    for line in lines(manifest, ""):
        print_result(filled(line[14:], line[:14]))


@scene.command()
@SCENE
@click.option(
    "--row", type=float, required=True, help="Row of the view, 0 at the top; fractions allowed."
)
@click.option(
    "--col", type=float, required=True, help="Column of the view, 0 at the left; fractions allowed."
)
@click.option(
    "--frame",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Frame of a light-field video.",
)
@click.option(
    "--method", type=click.Choice(["auto", *reversed(METHODS)]), default="auto", show_default=True
)
@click.option("-o", "--out", type=PATH, required=True, help="File for the picture.")
@OVERWRITE
@with_scene
def view(
    path: Path,
    row: float,
    col: float,
    frame: int,
    method: str,
    out: Path,
    overwrite: bool,
    config: Config,
) -> None:
    """Write the picture of a camera at ROW, COL of the grid."""
    check_picture(out, path, overwrite)
    field = opened(path, config)
    for name, value, count in (("row", row, field.rows), ("col", col, field.cols)):
        if not 0 <= value <= count - 1:  # not a number compares false
            raise UserError(
                f"--{name} {value:g}: the scene has {field.rows}x{field.cols} views",
                f"use 0 to {count - 1}",
            )
    if frame >= field.frames:
        raise UserError(
            f"--frame {frame}: the scene has {field.frames} frames",
            f"use --frame 0 to {field.frames - 1}",
        )
    if method in WARPS and field.disparity is None:
        raise UserError(
            f"--method {method}: {field.name} has no disparity", "use --method nearest or blend"
        )
    write_picture(out, ViewRenderer(field, method).render(row, col, frame))
