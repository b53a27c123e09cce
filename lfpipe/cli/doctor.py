"""`lfpipe doctor`: checks whether a session would run on this machine."""

from __future__ import annotations

import click


@click.command()
def doctor() -> int:
    """Check this machine, a line per check, with remedies. Exit code 1 if something would stop `lfpipe up SCENE`."""
    from lfpipe.observe.doctor import checks

    found = checks()
    for check in found:
        click.echo(f"{'ok  ' if check.ok else 'FAIL'} {check.name:<12} {check.detail}")
        if check.remedy:
            click.echo(f"     {'':<12} remedy: {check.remedy}")
    return 0 if all(check.ok for check in found) else 1
