"""Shell completions for keys of the configuration and running sessions; paths are completed by the shell."""

import click
from click.shell_completion import CompletionItem, get_completion_class


def settings(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """KEY=VALUE: the keys, then the words that a key accepts."""
    from lfpipe.config import choices, options

    key, sign, _ = incomplete.partition("=")
    if sign and key in options():
        words = ("true", "false") if bool in options()[key].types else choices(key)
        return [CompletionItem(f"{key}={word}") for word in words if f"{key}={word}".startswith(incomplete)]
    return [CompletionItem(f"{name}=", help=known.doc) for name, known in options().items() if name.startswith(incomplete)]


def sessions(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The running sessions."""
    from lfpipe.supervisor.rundir import running

    return [CompletionItem(name) for name in running() if name.startswith(incomplete)]


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the completion script of a shell: eval "$(lfpipe completion bash)"."""
    from lfpipe.cli import cli

    script = get_completion_class(shell)
    assert script is not None
    click.echo(script(cli, {}, "lfpipe", "_LFPIPE_COMPLETE").source())
