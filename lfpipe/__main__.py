"""Entry of the `lfpipe` command.

Nothing is imported at the top: spawned stages read this module again.
"""


def main() -> None:
    """Runs the command line."""
    from lfpipe.cli import run

    run()


if __name__ == "__main__":
    main()
