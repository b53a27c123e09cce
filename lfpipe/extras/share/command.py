"""Sharing: the option `--share` of `lfpipe up`, and the command `lfpipe ctl share`."""

from collections.abc import Callable
from typing import Any

import click

from lfpipe.cli.sessions import Send
from lfpipe.cli.terminal import Group
from lfpipe.extras.share.target import check_target, new_targets


def up(proceed: Callable[..., Any], *, share: tuple[str, ...], **values: Any) -> Any:
    """`lfpipe up` with targets."""
    if not share:
        return proceed(**values)
    return proceed(**values, extras={"share": new_targets(share, parse=check_target)})


@click.group(cls=Group)
def share() -> None:
    """Send the viewer's eyes and head to other programs."""


@share.command("start")
@click.argument("targets", nargs=-1, required=True, metavar="TARGET...")
@click.pass_obj
def start_share(send: Send, targets: tuple[str, ...]) -> None:
    """Start sharing with each TARGET, as the option `--share` of `lfpipe up`."""
    send({"cmd": "share", "start": list(new_targets(targets, parse=check_target))})


@share.command("stop")
@click.argument("targets", nargs=-1, metavar="[TARGET]...")
@click.pass_obj
def stop_share(send: Send, targets: tuple[str, ...]) -> None:
    """Stop sharing with each TARGET, as `start` printed it; without TARGET, with all."""
    send({"cmd": "share", "stop": list(targets)})


@share.command("list")
@click.pass_obj
def list_targets(send: Send) -> None:
    """Print what is shared."""
    send({"cmd": "share"})
