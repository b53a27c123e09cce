"""Exit codes of commands that a signal ends, and what they leave: nothing."""

import os
import signal
from pathlib import Path

import pytest

from tests.support import slow_source
from tests.support.world import World, until, write_package

ENDS = [(signal.SIGINT, 130), (signal.SIGTERM, 143)]
REPEATS = int(os.environ.get("LFPIPE_REPEATS", "3"))


@pytest.mark.live
@pytest.mark.parametrize(("signum", "code"), ENDS)
def test_command_is_interrupted_inside_native_code(
    world: World, scene: Path, signum: int, code: int
) -> None:
    """The interpreter's end would unwind a thread in C++, which aborts the process."""
    write_package(world.root / "packages", slow_source.ENTRY_POINT, "slow")
    world.env["PYTHONPATH"] += f"{os.pathsep}{world.root / 'packages'}"
    for number in range(REPEATS):
        opening = world.root / f"opening{number}"
        process = world.start("up", scene, "--camera", f"slow:{opening}", "--display", "none")
        until(opening.exists, "the source being opened")
        said = world.ended(process, signum, code)
        assert "terminate called" not in said
