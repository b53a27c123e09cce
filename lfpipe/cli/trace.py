"""`lfpipe trace`: records a timeline of a running session for Perfetto."""

import time
from pathlib import Path

import click

from lfpipe.cli.options import with_session


@click.group()
def trace() -> None:
    """Record a timeline of a running session as Chrome trace-event JSON, which Perfetto opens."""


@trace.command()
@click.argument("out", metavar="[OUT.json]", required=False, type=click.Path(path_type=Path))
@with_session
def start(out: Path | None, session_name: str | None) -> None:
    """Start a timeline. `lfpipe trace stop` writes it to OUT.json; the default is a name made of the time, in this folder."""
    from lfpipe.observe.session_commands import SessionCommands
    from lfpipe.observe.timeline import check_out
    from lfpipe.transport import control
    from lfpipe.transport.session import default_name

    out = (out or Path(time.strftime("lfpipe-%Y%m%d-%H%M%S.json"))).absolute()
    check_out(out)
    SessionCommands(session_name or default_name()).ask({"cmd": "trace", "path": f"{out}.part"}, control.FILE_CHECK_TIMEOUT_S)
    click.echo(f"recording; `lfpipe trace stop` writes {out}")


@trace.command()
@click.argument("out", metavar="[OUT.json]", required=False, type=click.Path(path_type=Path))
@with_session
def stop(out: Path | None, session_name: str | None) -> None:
    """End the timeline and write it to OUT.json, or to the file given to `start`."""
    from lfpipe.observe.session_commands import SessionCommands
    from lfpipe.observe.timeline import finish_trace
    from lfpipe.transport.session import default_name

    done = finish_trace(SessionCommands(session_name or default_name()).ask, out)
    click.echo(f"{done}: open it at ui.perfetto.dev, which does not upload it, or in chrome://tracing")
