"""Too little of everything: reported before a session starts; later, only the affected output ends.

Mounts and dropped privileges are real. Tests of permissions drop root's; without the right to
mount, tests of small disks are skipped.
"""

import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from lfpipe.sequence.folder import open_sequence
from tests.support.world import World

PLAIN = ("--camera", "demo", "--display", "none", "--duration", "0.5")
MAY_MOUNT = (
    shutil.which("unshare") is not None
    and subprocess.run(
        ["unshare", "-m", "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True
    ).returncode
    == 0
)
mounts = pytest.mark.skipif(not MAY_MOUNT, reason="no file system may be mounted here (needs root)")


Done = subprocess.CompletedProcess[str]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder for a small disk."""
    made = tmp_path / "small"
    made.mkdir()
    return made


def in_mounts(
    world: World, command: Iterable[object], *mounts: tuple[Path, str], after: str = ""
) -> Done:
    """Runs `lfpipe ...` with a tmpfs of these options at each place; stdout ends with what the
    shell command `after` prints.
    """
    lines = [f"mount -t tmpfs -o {options} tmpfs '{place}'" for place, options in mounts]
    words = " ".join(f"'{word}'" for word in (sys.executable, "-m", "lfpipe", *command))
    script = " && ".join(
        [*lines, f"{{ {words}; code=$?; echo ===; {after or 'true'}; exit $code; }}"]
    )
    return subprocess.run(
        ["unshare", "-m", "sh", "-c", script],
        capture_output=True,
        text=True,
        cwd=world.root,
        env=world.env,
        timeout=60,
    )


def assert_said(done: Done, world: World, *parts: str) -> None:
    """One message with a remedy, and no leftovers."""
    assert done.returncode == 2, done.stderr
    assert (
        "error: " in done.stderr and "remedy: " in done.stderr and "Traceback" not in done.stderr
    ), done.stderr
    assert all(part in done.stderr for part in parts), done.stderr
    assert not world.left(), "something is left"


@mounts
@pytest.mark.native("/dev/shm")
def test_up_with_too_little_shared_memory(world: World, scene: Path) -> None:
    for options, named in (
        ("size=1m", "--shm-size"),
        ("size=64m,ro", "Read-only file system"),
    ):
        world.env.pop("LFPIPE_RUN_DIR", None)  # the usual place
        done = in_mounts(
            world,
            ("up", scene, *PLAIN, "--session", world.name),
            (Path("/dev/shm"), options),
            after="ls /dev/shm",
        )
        assert_said(done, world, "/dev/shm", named)
        assert done.stdout.split("===\n")[1] == ""


@pytest.mark.parametrize(("soft", "hard", "code"), [(24, 24, 2), (24, 4096, 0)])
def test_up_raises_the_limit_of_open_files_or_reports_it(
    world: World, scene: Path, soft: int, hard: int, code: int
) -> None:
    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))

    done = world.run("up", scene, *PLAIN, "--session", world.name, preexec_fn=limited)
    if code:
        assert_said(done, world, "24 open files", "ulimit -n")
    else:
        assert done.returncode == 0, done.stderr


def test_outputs_in_directories_without_permission(
    world: World, scene: Path, as_nobody: list[str]
) -> None:
    closed = world.root / "closed"
    closed.mkdir(mode=0o500)
    up = ("up", scene, *PLAIN, "--session", world.name)
    video = ("up", scene, "--camera", "demo", "--display", f"file:{closed}/v.mkv")
    for command, named in (
        (up, (str(closed), "LFPIPE_RUN_DIR")),
        ((*up, "--set", f"scene.cache_dir={closed}"), (str(closed), "scene.cache_dir")),
        ((*up, "--trace", closed / "t.jsonl"), ("t.jsonl",)),
        (video, ("v.mkv",)),
        (("record", closed / "rec", "--camera", "demo"), (str(closed / "rec"),)),
    ):
        words = [*as_nobody, sys.executable, "-m", "lfpipe", *map(str, command)]
        env = world.env | ({"LFPIPE_RUN_DIR": str(closed)} if command is up else {})
        done = subprocess.run(
            words, capture_output=True, text=True, cwd=world.root, env=env, timeout=60
        )
        assert_said(done, world, "Permission denied", *named)


@mounts
def test_trace_and_video_end_on_full_disks_and_the_session_goes_on(
    world: World, scene: Path
) -> None:
    # apart: whichever is first would fill the other's disk
    videos, traces = world.root / "videos", world.root / "traces"
    for place in (videos, traces):
        place.mkdir()
    shown = "--display", f"file:{videos}/v.mkv", "--duration", "1.5"
    command = ("up", scene, "--camera", "demo", *shown, "--session", world.name)
    full = (videos, "size=24k"), (traces, "size=12k")
    done = in_mounts(
        world, (*command, "--trace", traces / "t.jsonl"), *full, after=f"cat {traces}/t.jsonl"
    )
    assert done.returncode == 1 and "Traceback" not in done.stderr and "2 files" in done.stderr, (
        done.stderr
    )
    assert done.stderr.count("t.jsonl: No space left on device; it ends here") == 1
    assert done.stderr.count("v.mkv: the video ends here") == 1
    assert "finished (--duration reached)" in done.stderr
    trace = done.stdout.split("===\n")[1]
    assert trace.endswith("}\n") and [json.loads(line)["seq"] for line in trace.splitlines()], (
        "whole lines"
    )
    assert not world.left()


@mounts
def test_record_on_a_full_disk_ends_with_a_whole_frame(world: World, place: Path) -> None:
    kept = world.root / "kept"
    after = f"cp -r {place}/rec {kept}"
    done = in_mounts(
        world,
        ("record", place / "rec", "--camera", "demo", "--duration", "20"),
        (place, "size=1m"),
        after=after,
    )
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
    assert "No space left on device" in done.stderr and "stopped early" in done.stderr
    sequence = open_sequence(kept)
    assert 2 <= len(sequence.packets) < 300
    assert f"frames stored: {len(sequence.packets)}\n" in done.stderr, done.stderr
    sequence.frame(len(sequence.packets) - 1)
    assert not list(kept.glob("*.new")) and not world.left()
