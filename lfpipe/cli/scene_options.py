"""Options and helpers of the commands of `lfpipe scene`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from lfpipe.cli import completions
from lfpipe.cli.options import with_config

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfpipe.config import Config
    from lfpipe.scene.lightfield import LightField

PICTURES = (".png", ".jpg", ".jpeg", ".jps")
F = TypeVar("F", bound=Callable[..., Any])
SCENE = click.argument("path", metavar="SCENE", type=click.Path(path_type=Path), shell_complete=completions.scenes)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


def with_scene_options(command: F) -> F:
    """--layout, --grid, --flip, --transpose, --gamma, --config, --set."""
    options = [
        click.option("--layout", metavar="NAME", help="Layout on disk; detected by default."),
        click.option("--grid", metavar="ROWSxCOLS", help="Grid of views in file order, if the files do not define it."),
        click.option("--flip", type=click.Choice(["none", "rows", "cols", "both"]), help="Reverse rows or columns of the grid."),
        click.option("--transpose/--no-transpose", default=None, help="Exchange rows and columns of the grid, before any flip."),
        click.option("--gamma", metavar="G", help="Convert linear light to screen values, out = in ** (1/G); 1 for none."),
        click.option("--force", is_flag=True, help="Open pictures even if they do not look like one light field."),
        with_config,
    ]
    for option in reversed(options):
        command = option(command)
    return command


def scene_config(options: dict[str, Any]) -> Config:
    """The configuration with the scene options applied. Raises UserError."""
    from lfpipe.config import load, parse_set, updated

    config = load(options["config_file"], options["sets"])
    chosen: dict[str, Any] = {f"scene.{key}": options[key] for key in ("layout", "grid", "flip") if options[key] is not None}
    if options["force"]:
        chosen["scene.force"] = True
    if options["transpose"] is not None:
        chosen["scene.transpose"] = "yes" if options["transpose"] else "no"
    if options["gamma"] is not None:
        chosen["scene.gamma"] = parse_set(f"scene.gamma={options['gamma']}")[1]
    return updated(config, chosen)


def opened(path: Path | None, config: Config) -> LightField:
    """Opens the scene, or the demo; packs it first if necessary, with a progress bar. Raises UserError."""
    from lfpipe.cli.progress import progress
    from lfpipe.scene.open_scene import open_scene

    with progress() as bar:
        return open_scene(path, config.scene, bar)


def check_picture(path: Path, scene: Path) -> None:
    """Raises UserError if a command that reads scene must not write a picture to path. Called before any work."""
    from lfpipe.errors import UserError
    from lfpipe.files.output import check_output
    from lfpipe.host.paths import is_dir

    if path.suffix.lower() not in PICTURES:
        raise UserError(f"{path}: not {', '.join(PICTURES[:-1])} or {PICTURES[-1]}", "for example view.png")
    if is_dir(scene) and path.resolve().is_relative_to(scene.resolve()):
        raise UserError(f"{path}: in the folder of the scene, which would count it as a view", "name a file in another folder")
    check_output(path, [scene])


def write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Writes an RGB picture to a path that `check_picture` allows. Raises UserError."""
    import cv2

    from lfpipe.files.output import marked_picture, write_output

    suffix = ".png" if path.suffix.lower() == ".png" else ".jpg"
    _, data = cv2.imencode(suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    write_output(path, marked_picture(data.tobytes()))
    click.echo(path)
