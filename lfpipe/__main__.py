"""Entry of the `lfpipe` command.

Nothing is imported at the top: spawned stages read this module again.
"""


def main() -> None:
    """Runs the command line."""
    try:
        from lfpipe.cli import run
    except KeyboardInterrupt:  # Ctrl-C at once; `run` handles it later
        raise SystemExit(130) from None
    run()


if __name__ == "__main__":
    main()
