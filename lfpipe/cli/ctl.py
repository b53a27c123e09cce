"""`lfpipe ctl`: queries and controls a running session."""

import itertools
import json
from pathlib import Path
from typing import Any

import attrs
import click

from lfpipe.cli import completions
from lfpipe.cli.options import with_session

LOAD_S = 900.0  # packing a large scene takes minutes


VALUED = ("--session",)


@attrs.frozen
class Target:
    """The session to talk to, and how to print its answers."""

    session_name: str | None
    as_json: bool


class Leading(click.Group):
    """A group whose own options may also follow the command: `ctl status --json`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        end = args.index("--") if "--" in args else len(args)
        front: list[str] = []
        back: list[str] = []
        words = iter(args[:end])
        for word in words:
            if word in VALUED:
                front += [word, *itertools.islice(words, 1)]
            else:
                (front if word == "--json" or word.partition("=")[0] in VALUED else back).append(word)
        return super().parse_args(ctx, [*front, *back, *args[end:]])


@click.group(cls=Leading)
@with_session
@click.option("--json", "as_json", is_flag=True, help="Print answers as JSON.")
@click.pass_context
def ctl(context: click.Context, session_name: str | None, as_json: bool) -> None:
    """Query and control a running session. A change shows in the next picture.

    For a session on another machine: ssh HOST lfpipe ctl ...
    """
    context.obj = Target(session_name, as_json)


def _ask(target: Target, message: dict[str, Any], timeout_s: float) -> dict[str, Any]:
    from lfpipe.supervisor.rundir import find
    from lfpipe.transport import control
    from lfpipe.transport.session import default_name

    return control.request(find(target.session_name or default_name()).run_dir, message, timeout_s)


def _send(target: Target, message: dict[str, Any], timeout_s: float = 3.0) -> None:
    answer = _ask(target, message, timeout_s)
    answer = {key: value for key, value in answer.items() if key != "v"}
    if target.as_json:
        click.echo(json.dumps(answer))
    elif message["cmd"] == "status":
        from lfpipe.observe.latency_table import latency_table

        latency_table(answer)
    else:
        said = ", ".join(f"{key} {value}" for key, value in answer.items() if key not in ("ok", "rev", "applied"))
        click.echo(f"{message['cmd']}: done{', ' + said if said else ''}")


@ctl.command("set")
@click.argument("sets", nargs=-1, required=True, metavar="KEY=VALUE...", shell_complete=completions.settings)
@click.pass_obj
def set_keys(target: Target, sets: tuple[str, ...]) -> None:
    """Change keys of the configuration: all of them, or none if one is refused."""
    from lfpipe.config import parse_set

    _send(target, {"cmd": "set", "set": dict(parse_set(text) for text in sets)})


@ctl.command()
@click.argument("scene", required=False, type=click.Path(path_type=Path), shell_complete=completions.scenes)
@click.option("--next", "step", flag_value=1, type=int, help="The next scene of the playlist.")
@click.option("--previous", "step", flag_value=-1, type=int, help="The previous scene of the playlist.")
@click.option("--layout", help="Its layout on disk, if it is not detected.")
@click.option("--grid", metavar="ROWSxCOLS", help="Its grid, if the files do not define it.")
@click.pass_obj
def load(target: Target, scene: Path | None, step: int | None, layout: str | None, grid: str | None) -> None:
    """Show another light field. It is packed first if necessary; the old one stays visible meanwhile."""
    if (scene is None) == (step is None):
        raise click.UsageError("give one of SCENE, --next and --previous")
    how = {key: value for key, value in (("layout", layout), ("grid", grid)) if value is not None}
    which = {"step": step} if scene is None else {"scene": str(scene.resolve())}
    _send(target, {"cmd": "load", **which, **how}, LOAD_S)


def _plain(word: str, text: str) -> None:
    @ctl.command(word, help=text)
    @click.pass_obj
    def command(target: Target) -> None:
        _send(target, {"cmd": word})


_plain("status", "State and latency of every stage.")
_plain("pause", "Freeze the picture; frames are discarded.")
_plain("resume", "Continue after pause.")
_plain("recentre", "Make the viewer's position the centre of the grid.")
_plain("stop", "End the session.")


@ctl.group()
def record() -> None:
    """Record the camera of a running session."""


@record.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--with-eyes", is_flag=True, help="Store the tracked eyes with the frames.")
@click.pass_obj
def start(target: Target, out: Path, with_eyes: bool) -> None:
    """Record to the new folder OUT, until `stop` or the end of the session."""
    from lfpipe.transport.control import FILE_CHECK_TIMEOUT_S

    _send(target, {"cmd": "record", "path": str(out.resolve()), "eyes": with_eyes}, FILE_CHECK_TIMEOUT_S)


@record.command("stop")
@click.pass_obj
def stop_record(target: Target) -> None:
    """End the recording."""
    _send(target, {"cmd": "record", "path": ""})


@ctl.group()
def share() -> None:
    """Send the viewer's eyes and head to other programs."""


@share.command("start")
@click.argument("targets", nargs=-1, required=True, metavar="TARGET...")
@click.pass_obj
def start_share(target: Target, targets: tuple[str, ...]) -> None:
    """Start sharing with each TARGET: opentrack:HOST:PORT, osc:HOST:PORT or lsl[:NAME]. Append ?rate=HZ for predicted eyes."""
    from lfpipe.transport.control import FILE_CHECK_TIMEOUT_S

    _send(target, {"cmd": "share", "start": list(targets)}, FILE_CHECK_TIMEOUT_S)


@share.command("stop")
@click.argument("targets", nargs=-1, metavar="[TARGET]...")
@click.pass_obj
def stop_share(target: Target, targets: tuple[str, ...]) -> None:
    """Stop sharing with each TARGET, written as `start` printed it. Without TARGET, stop all sharing."""
    _send(target, {"cmd": "share", "stop": list(targets)})
