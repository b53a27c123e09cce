"""`lfpipe monitor`: look at a running session without touching it."""

from __future__ import annotations

import click

from lfpipe.cli.options import with_session


@click.command()
@with_session
@click.option("--once", is_flag=True, help="Print the state once and end.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
@click.option("--csv", "as_csv", is_flag=True, help="One line of comma-separated values a sample, with a head.")
@click.option("--web", is_flag=False, flag_value="", metavar="[[HOST]:PORT]",
              help="Serve a page with charts, pictures and controls on 127.0.0.1, or on HOST, behind a token.")  # fmt: skip
@click.option("--port", type=click.IntRange(0, 65535), help="Port of --web, 0 for a free one.  [default: 8765]")
@click.option("--prometheus", metavar="[HOST]:PORT", help="Serve metrics for Prometheus on 127.0.0.1, or on HOST.")
def monitor(
    session_name: str | None, once: bool, as_json: bool, as_csv: bool, web: str | None, port: int | None, prometheus: str | None
) -> None:
    """Show latency, rate, drops and load of every stage of a running session.

    On a terminal: a screen, four times a second; several may watch at once, and it waits for a session that starts again.
    Keys: q quit, p pause, r reset, t take a trace, w warp on and off, m mode, c recentre.
    """
    from lfpipe.transport.session import default_name

    name = session_name or default_name()
    served = (("--web", web is not None), ("--prometheus", prometheus is not None))
    chosen = [word for word, on in (("--json", as_json), ("--csv", as_csv), *served) if on]
    chosen += ["--once"] * (once and any(on for _, on in served))  # which goes with --json, and with --csv
    if len(chosen) > 1:
        raise click.UsageError(f"{' and '.join(chosen)} exclude each other")
    if port is not None and web != "":
        raise click.UsageError("--port belongs to --web without an address")
    if web is not None:
        from lfpipe.observe.web import serve

        serve(name, web or f":{8765 if port is None else port}", click.echo)
    elif prometheus is not None:
        from lfpipe.observe.prometheus import serve as export

        export(name, prometheus, click.echo)
    else:
        from lfpipe.observe import terminal

        terminal.run(name, once, "json" if as_json else "csv" if as_csv else "")
