"""Entry of the desktop's menu: `lfpipe`, whose errors appear in a dialog.

Nothing is imported at the top: spawned stages read this module again.
"""


def main() -> None:
    """Runs the command line."""
    from lfpipe.cli import run
    from lfpipe.extras.exhibition.desktop import show_error

    run(show_error)


if __name__ == "__main__":
    main()
