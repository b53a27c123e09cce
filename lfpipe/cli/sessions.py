"""Commands to running sessions: `lfpipe monitor`, `ctl` and `trace`.

Scripts ask often: what an answer alone does not need is imported where it is used.
"""

import itertools
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

from lfpipe import config as configuration
from lfpipe.cli.options import OVERWRITE, PATH, SESSION
from lfpipe.cli.terminal import ExtensibleGroup, Group, print_result
from lfpipe.config import converter, parse_set
from lfpipe.supervisor.rundir import ask
from lfpipe.transport.control import FILE_CHECK_TIMEOUT_S, LOAD_TIMEOUT_S, Message

SAID = {
    "load": "shown: {name}",
    "share": "shared: {share}",
    "viewer": "viewer: {source}",
    "record": "record: {path}",
    "trace": "trace: {path}",
}
Send = Callable[..., None]  # of one message, and perhaps timeout_s


@click.command()
@SESSION
@click.option("--once", is_flag=True, help="Print the state once and exit.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
def monitor(session_name: str, once: bool, as_json: bool) -> None:
    """Show latency, rate, drops and load of every stage of a running session.

    On a terminal, the screen updates four times a second; otherwise the state is printed once.
    If the session ends, the monitor waits for it to restart.
    Keys: q quit, p pause, r reset, t record a timeline, w toggle warp, m mode, c recentre.
    """
    from lfpipe.monitor.monitor import run

    run(session_name, once, as_json)


class Leading(ExtensibleGroup):
    """A group whose own options may also follow the command: `ctl status --json`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        end = args.index("--") if "--" in args else len(args)
        front: list[str] = []
        back: list[str] = []
        words = iter(args[:end])
        for word in words:
            if word == "--session":
                front += [word, *itertools.islice(words, 1)]
            else:
                (front if word == "--json" or word.startswith("--session=") else back).append(word)
        return super().parse_args(ctx, [*front, *back, *args[end:]])


@click.group(cls=Leading)
@SESSION
@click.option("--json", "as_json", is_flag=True, help="Print answers as JSON.")
@click.pass_context
def ctl(context: click.Context, session_name: str, as_json: bool) -> None:
    """Query and control a running session. The next picture shows a change.

    For a session on another machine: ssh HOST lfpipe ctl ...
    """
    context.obj = partial(_send, session_name, as_json)


def _send(session_name: str, as_json: bool, message: Message, timeout_s: float = 3.0) -> None:
    answer = ask(session_name, message, timeout_s)
    answer.pop("v", None)
    if as_json:
        print_result(json.dumps(answer))
    elif message["cmd"] == "status":
        from lfpipe.monitor.monitor import print_state
        from lfpipe.supervisor.metrics import SessionMetrics

        print_state(converter().structure(answer, SessionMetrics), answer["paused"])
    else:
        print_result(SAID.get(message["cmd"], f"{message['cmd']}: done").format_map(answer))


def load_scene(session_name: str, scene: Path) -> None:
    """Shows another light field in a session. Raises UserError."""
    ask(session_name, {"cmd": "load", "scene": _absolute(scene)}, LOAD_TIMEOUT_S)


def _absolute(scene: Path) -> str:
    from lfpipe.scene.pack import absolute_path  # itself slow to import

    return str(absolute_path(scene, configuration.load().scene))


@ctl.command("set")
@click.argument("sets", nargs=-1, required=True, metavar="KEY=VALUE...")
@click.pass_obj
def set_keys(send: Send, sets: tuple[str, ...]) -> None:
    """Change configuration keys: all of them, or none if one is refused."""
    send({"cmd": "set", "set": dict(parse_set(text) for text in sets)})


@ctl.command()
@click.argument("scene", required=False, type=PATH)
@click.option("--next", "step", flag_value=1, type=int, help="The next scene of the playlist.")
@click.option(
    "--previous", "step", flag_value=-1, type=int, help="The previous scene of the playlist."
)
@click.option("--layout", help="Layout on disk; default: detect it.")
@click.option("--grid", metavar="ROWSxCOLS", help="Grid of views; default: detect it.")
@click.pass_obj
def load(
    send: Send, scene: Path | None, step: int | None, layout: str | None, grid: str | None
) -> None:
    """Show another light field.

    If necessary, it is packed first; the current one stays visible meanwhile.
    """
    if (scene is None) == (step is None):
        raise click.UsageError("specify one of SCENE, --next and --previous")
    how = {"step": step, "scene": scene and _absolute(scene), "layout": layout, "grid": grid}
    send(
        {"cmd": "load", **{key: value for key, value in how.items() if value is not None}},
        LOAD_TIMEOUT_S,
    )


def _plain(word: str, text: str) -> None:
    @ctl.command(word, help=text)
    @click.pass_obj
    def command(send: Send) -> None:
        send({"cmd": word})


_plain("status", "Print state and latency of every stage.")
_plain("pause", "Freeze the picture and discard frames.")
_plain("resume", "Continue after pause.")
_plain("recentre", "Make the viewer's position the centre of the grid.")
_plain("stop", "End the session.")


@ctl.command()
@click.argument("source", metavar="SOURCE")
@click.pass_obj
def viewer(send: Send, source: str) -> None:
    """Choose who looks: a camera or file, as for `--camera`, `demo`, or `mouse`."""
    kind, _, path = source.partition(":")
    if kind == "file":  # the session may run in another folder
        source = f"file:{Path(path).expanduser().absolute()}"
    send({"cmd": "viewer", "source": source}, FILE_CHECK_TIMEOUT_S)


@ctl.group()
def record() -> None:
    """Record the camera of a running session."""


@record.command()
@click.argument("out", type=PATH)
@click.pass_obj
def start(send: Send, out: Path) -> None:
    """Record to the new folder OUT until `stop` or the end of the session."""
    send({"cmd": "record", "path": str(out.resolve())}, FILE_CHECK_TIMEOUT_S)


@record.command("stop")
@click.pass_obj
def stop_record(send: Send) -> None:
    """End the recording."""
    send({"cmd": "record", "path": ""})


@click.group(cls=Group)
def trace() -> None:
    """Trace a running session, one JSON line per picture, and convert traces to timelines."""


@trace.command("start")
@click.argument("out", metavar="[OUT.jsonl]", required=False, type=PATH)
@SESSION
def start_trace(out: Path | None, session_name: str) -> None:
    """Start a trace, as `lfpipe up --trace` does.

    OUT.jsonl defaults to a name with the current time, in this folder.
    """
    from lfpipe.monitor.monitor import begin_trace

    path = begin_trace(partial(ask, session_name), out)
    print_result(f"tracing to {path}; end it with `lfpipe trace stop`")


@trace.command("stop")
@SESSION
def stop_trace(session_name: str) -> None:
    """End the trace."""
    from lfpipe.monitor.monitor import finish_trace

    path = finish_trace(partial(ask, session_name))
    print_result(f"{path}: convert it to a timeline with `lfpipe trace timeline {path}`")


@trace.command("timeline")
@click.argument("source", metavar="TRACE.jsonl", type=PATH)
@click.argument("out", metavar="[OUT.json]", required=False, type=PATH)
@OVERWRITE
def write_timeline(source: Path, out: Path | None, overwrite: bool) -> None:
    """Convert a trace to Chrome trace-event JSON, which Perfetto opens.

    OUT.json defaults to the name of the trace.
    """
    from lfpipe.monitor.monitor import convert

    out = out or source.with_suffix(".json")
    convert(source, out, overwrite)
    print_result(
        f"{out}: open it at ui.perfetto.dev, which does not upload it, or in chrome://tracing"
    )
