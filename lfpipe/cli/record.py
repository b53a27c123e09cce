"""`lfpipe record`: records a camera to disk."""

import os
from pathlib import Path

import attrs
import click

from lfpipe.cli.options import with_camera, with_config


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@with_camera
@click.option("--duration", "duration_s", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Stop after S seconds.")
@click.option("--with-eyes", is_flag=True, help="Track the eyes and store them with the frames.")
@with_config
def record(
    out: Path, camera: str | None, duration_s: float | None, with_eyes: bool, sets: tuple[str, ...], config_file: str | None
) -> int:
    """Record a camera to the new folder OUT, for `lfpipe replay`. Ctrl-C ends it. See also `lfpipe ctl record`."""
    from lfpipe import config as config_module
    from lfpipe.capture.open_source import camera_name, check_source
    from lfpipe.cli.launch import exit_code, say
    from lfpipe.config.user_files import with_measured_focal
    from lfpipe.sequence.folder import check_out
    from lfpipe.supervisor.supervisor import run_session
    from lfpipe.transport.session import Session

    config = config_module.load(config_file, sets)
    source = check_source(camera or config.camera.source, config.camera)
    config = with_measured_focal(config, camera_name(source.text))
    check_out(out)
    options = attrs.evolve(source.options, tracking=with_eyes, show=False, record=str(out.resolve()), record_eyes=with_eyes)
    outcome = run_session(Session(f"record.{os.getpid()}"), config, options, say, duration_s)
    return exit_code(outcome)
