"""`lfpipe monitor`: look at a running session without touching it."""

from __future__ import annotations

import json
import time

import click

from lfpipe.cli.options import with_session


@click.command()
@with_session
@click.option("--once", is_flag=True, help="Print the state once and end.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line instead of a table.")
def monitor(session_name: str | None, once: bool, as_json: bool) -> None:
    """Show latency, rate and drops of every stage of a running session."""
    from lfpipe.cli.report import latency_table
    from lfpipe.observe.watch import Watch
    from lfpipe.supervisor.rundir import find
    from lfpipe.transport.session import default_name

    with Watch(find(session_name or default_name())) as watch:
        while True:
            state = watch.read()
            if as_json:
                click.echo(json.dumps(state))
            else:
                if not once:
                    click.clear()
                latency_table(state)
            if once or not watch.living():
                return
            time.sleep(0.25)
