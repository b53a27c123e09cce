"""`lfpipe monitor --web`."""

from collections.abc import Callable
from typing import Any

import click

from lfpipe.cli.terminal import print_result


def monitor(proceed: Callable[..., Any], *, web: str | None, **values: Any) -> Any:
    """Serves the page instead of running the terminal monitor."""
    if web is None:
        return proceed(**values)
    if values["once"] or values["as_json"]:
        raise click.UsageError(f"--web excludes {'--once' if values['once'] else '--json'}")
    from lfpipe.extras.web.server import serve  # Tornado is not needed for anything else

    return serve(values["session_name"], web, print_result)
