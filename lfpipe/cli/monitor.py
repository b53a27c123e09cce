"""`lfpipe monitor`: watches a running session without disturbing it."""

import click

from lfpipe.cli.options import with_session


@click.command()
@with_session
@click.option("--once", is_flag=True, help="Print the state once and end.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
@click.option("--csv", "as_csv", is_flag=True, help="Comma-separated values: a header, then one line per sample.")
@click.option("--web", is_flag=False, flag_value="", metavar="[[HOST]:PORT]",
              help="Serve a page with charts, pictures and controls on 127.0.0.1, or on HOST; a token protects it.")  # fmt: skip
@click.option("--port", type=click.IntRange(0, 65535), help="Port of --web, 0 for a free one.  [default: 8765]")
@click.option("--prometheus", metavar="[HOST]:PORT", help="Serve metrics for Prometheus on 127.0.0.1, or on HOST.")
def monitor(
    session_name: str | None, once: bool, as_json: bool, as_csv: bool, web: str | None, port: int | None, prometheus: str | None
) -> None:
    """Show latency, rate, drops and load of every stage of a running session.

    On a terminal, the screen updates four times a second. Several monitors may watch one session. If the session ends,
    the monitor waits for it to start again.
    Keys: q quit, p pause, r reset, t record a timeline, w toggle warp, m mode, c recentre.
    """
    from lfpipe.transport.session import default_name

    name = session_name or default_name()
    served = (("--web", web is not None), ("--prometheus", prometheus is not None))
    chosen = [word for word, on in (("--json", as_json), ("--csv", as_csv), *served) if on]
    chosen += ["--once"] * (once and any(on for _, on in served))  # --once may be combined with --json and --csv
    if len(chosen) > 1:
        raise click.UsageError(f"{' and '.join(chosen)} exclude each other")
    if port is not None and web != "":
        raise click.UsageError("--port needs --web without an address")
    if web is not None:
        from lfpipe.observe.web import serve

        serve(name, web or f":{8765 if port is None else port}", click.echo)
    elif prometheus is not None:
        from lfpipe.observe.prometheus import serve as export

        export(name, prometheus, click.echo)
    else:
        from lfpipe.observe import terminal

        terminal.run(name, once, "json" if as_json else "csv" if as_csv else "")
