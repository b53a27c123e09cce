"""Shell completions for the values of options and arguments; `lfpipe completion SHELL` enables them."""

import os
from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import BashComplete, CompletionItem, add_completion_class, get_completion_class, split_arg_string

BREAKS = "=:"  # bash treats the text after one of these as a separate word


def _items(words: Iterable[str], incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(word) for word in words if word.startswith(incomplete)]


def _paths(incomplete: str, suffixes: tuple[str, ...] = ()) -> list[str]:
    """Folders and files that begin with incomplete; files with one of suffixes only, if any are given."""
    folder, _, start = incomplete.rpartition("/")
    root = Path(f"{folder}/" if folder or incomplete.startswith("/") else ".").expanduser()
    found = []
    try:
        entries = sorted(os.scandir(root), key=lambda entry: entry.name)
    except OSError:
        return []
    for entry in entries:
        if entry.name.startswith(start) and (start.startswith(".") or not entry.name.startswith(".")):
            word = f"{folder}/{entry.name}" if "/" in incomplete else entry.name
            if entry.is_dir():
                found.append(f"{word}/")
            elif not suffixes or entry.name.lower().endswith(suffixes):
                found.append(word)
    return found


def settings(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """KEY=VALUE: the keys, then the words that a key accepts."""
    from lfpipe.config import choices, options

    key, sign, _ = incomplete.partition("=")
    if not sign:
        return [CompletionItem(f"{name}=", help=opt.doc) for name, opt in options().items() if name.startswith(key)]
    if key not in options():
        return []
    words = choices(key)
    if bool in options()[key].types:
        words = ("true", "false")
    elif key == "scene.layout":
        from lfpipe.scene.layouts import layouts

        words = ("auto", *layouts())
    return _items((f"{key}={word}" for word in words), incomplete)


def config_files(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Presets, and TOML files."""
    from lfpipe.config.layers import presets

    return _items([*presets(), *_paths(incomplete, (".toml",))], incomplete)


def sessions(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The running sessions."""
    from lfpipe.supervisor.rundir import running

    return _items(running(), incomplete)


def displays(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The displays."""
    files = [f"file:{path}" for path in _paths(incomplete.removeprefix("file:"), (".mkv", ".mp4"))]
    return _items(["window", "fullscreen", "none", *(files if incomplete.startswith("file:") else ["file:"])], incomplete)


def sources(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The sources of frames."""
    from lfpipe.capture.camera_list import known

    if incomplete.startswith("file:"):
        return _items([f"file:{path}" for path in _paths(incomplete.removeprefix("file:"))], incomplete)
    return _items(["demo", "file:", *(f"camera:{device.path}" for device in known().nodes())], incomplete)


def scenes(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Files and folders, and the sources of packed scenes."""
    from lfpipe.config import load
    from lfpipe.errors import UserError
    from lfpipe.scene.cache import packs

    try:
        packed = [str(manifest.get("source", "")) for _, manifest, _ in packs(load().scene)]
    except UserError:
        packed = []
    return _items(dict.fromkeys([*_paths(incomplete), *(path for path in packed if os.path.exists(path))]), incomplete)  # noqa: PTH110 - as typed


class WholeWordBash(BashComplete):
    """Completes words that contain `=` or `:`. Bash breaks words there, so it gets only the part after the last break."""

    def get_completion_args(self) -> tuple[list[str], str]:
        line = os.environ.get("COMP_LINE", "")[: int(os.environ.get("COMP_POINT", "0") or 0)]
        words = split_arg_string(line)
        self._incomplete = words.pop() if words and not line[-1:].isspace() else ""
        return words[1:], self._incomplete

    def format_completion(self, item: CompletionItem) -> str:
        at = max(self._incomplete.rfind(each) for each in BREAKS) + 1
        return f"{item.type},{item.value[at:]}"

    def source(self) -> str:
        """Passes the whole line on, and appends no space to an unfinished word."""
        given, end = "COMP_CWORD=$COMP_CWORD", "    return 0\n"
        line = f'{given} COMP_LINE="$COMP_LINE" COMP_POINT=$COMP_POINT'
        goes_on = "    [[ ${#COMPREPLY[@]} == 1 && ${COMPREPLY[0]} == *[=:/] ]] && compopt -o nospace\n"
        return super().source().replace(given, line).replace(end, goes_on + end)


add_completion_class(WholeWordBash)


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the completion script of a shell: eval "$(lfpipe completion bash)"."""
    from lfpipe.cli import cli

    script = get_completion_class(shell)
    assert script is not None
    click.echo(script(cli, {}, "lfpipe", "_LFPIPE_COMPLETE").source())
