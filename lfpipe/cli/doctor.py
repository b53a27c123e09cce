"""`lfpipe doctor`: checks whether a session would run on this machine."""

import click


@click.command()
def doctor() -> int:
    """Check this machine: one line per check, with remedies. Exit code 1 if `lfpipe up SCENE` would fail."""
    from lfpipe.cli.progress import filled
    from lfpipe.observe.doctor import checks

    found = checks()
    for check in found:
        head = f"{'ok  ' if check.ok else 'FAIL'} {check.name:<12} "
        click.echo(filled(check.detail, head))
        if check.remedy:
            click.echo(filled(f"remedy: {check.remedy}", " " * len(head)))
    return 0 if all(check.ok for check in found) else 1
