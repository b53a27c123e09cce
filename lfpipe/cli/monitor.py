"""`lfpipe monitor`: watches a running session without disturbing it."""

import click

from lfpipe.cli.options import with_session


@click.command()
@with_session
@click.option("--once", is_flag=True, help="Print the state once and end.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
@click.option("--web", is_flag=False, flag_value="", metavar="[[HOST]:PORT]",
              help="Serve a page with charts, pictures and controls on 127.0.0.1, or on HOST; a token protects it.")  # fmt: skip
def monitor(session_name: str | None, once: bool, as_json: bool, web: str | None) -> None:
    """Show latency, rate, drops and load of every stage of a running session.

    On a terminal, the screen updates four times a second. Several monitors may watch one session. If the session ends,
    the monitor waits for it to start again.
    Keys: q quit, p pause, r reset, t record a timeline, w toggle warp, m mode, c recentre.
    """
    from lfpipe.transport.session import default_name

    name = session_name or default_name()
    if web is not None:
        if once or as_json:
            raise click.UsageError(f"--web excludes {'--once' if once else '--json'}")
        from lfpipe.observe.web import serve

        serve(name, web or ":8765", click.echo)
    else:
        from lfpipe.observe import terminal

        terminal.run(name, once, as_json)
