"""The checks of `lfpipe doctor`, on this machine and on simulated faults."""

import errno
import os
import re
import resource
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.monitor import doctor
from tests.support.processes import largest_file
from tests.support.refusal import refusal
from tests.support.world import World


def test_doctor_checks_shared_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setenv("LFPIPE_RUN_DIR", str(tmp_path))
    monkeypatch.setattr(os, "posix_fallocate", full)
    check = doctor.session(config.Config())
    assert not check.ok and "shm-size" in check.remedy


def limited(kind: int, most: int) -> Callable[[], None]:
    """Sets a limit of this process."""
    return lambda: resource.setrlimit(kind, (most, most))


# what is limited -> the environment and the limit of `lfpipe doctor`, and what it fails and says
LIMITED: dict[str, tuple[dict[str, str], Callable[[], None] | None, str, tuple[str, ...]]] = {
    "open files": ({}, limited(resource.RLIMIT_NOFILE, 64), "session", ("64 open", "ulimit -n")),
    "file size": ({}, limited(resource.RLIMIT_FSIZE, 100_000), "session", ("ulimit -f",)),
    "run directory": ({"LFPIPE_RUN_DIR": "/proc"}, None, "session", ("LFPIPE_RUN_DIR", "/proc")),
    "cache": ({"XDG_CACHE_HOME": "/proc"}, None, "cache", ("/proc/lfpipe", "scene.cache_dir")),
}


@pytest.mark.native("limits and /proc")
@pytest.mark.parametrize("what", LIMITED)
def test_doctor_names_the_limit_that_up_would_hit(world: World, what: str) -> None:
    environment, limit, name, parts = LIMITED[what]
    world.env |= environment | {"COLUMNS": "200"}
    done = world.run("doctor", preexec_fn=limit)
    assert done.returncode == 1 and not done.stderr, done.stderr
    assert done.stdout.startswith(f"sessions fail here: {name}\n")
    failed = re.findall(r"^FAIL (\w+) +(.*(?:\n +.*)*)", done.stdout, re.M)
    assert [check for check, _ in failed] == [name], failed
    assert all(part in failed[0][1] for part in parts), failed
    assert not world.left()


def test_doctor_fails_where_up_would_stop_and_fits_80_columns(world: World) -> None:
    world.env["COLUMNS"] = "80"
    done = world.run("doctor")
    assert done.returncode == 0, "without a screen, sessions show to a file"
    assert re.match(r"sessions run here\n(?s:.*)^ok   display +no screen", done.stdout, re.M)
    assert "ok   python" not in done.stdout, "it needs no remedy"
    assert max(len(line) for line in done.stdout.splitlines() if "/" not in line) <= 80
    settings = world.root / "settings" / "lfpipe" / "config.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text('[camera]\nsource = "demo"\n')
    done = world.run("doctor", "-v")
    assert re.search(r"^ok   camera +camera\.source is demo", done.stdout, re.M)
    settings.write_text("[camera]\nsauce = 3\n")
    failed = world.run("doctor")
    assert failed.returncode == 1
    assert re.search(r"^FAIL settings .*camera\.sauce", failed.stdout, re.M | re.S)


def test_write_report_is_whole_private_and_replaces_its_own(tmp_path: Path) -> None:
    path = tmp_path / "report.zip"
    with largest_file(2000), pytest.raises(UserError, match=r"report\.zip"):
        doctor.write_report(path, [])
    assert list(tmp_path.iterdir()) == []
    doctor.write_report(path, [])
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert "versions.json" in zipfile.ZipFile(path).namelist()
    assert "already exists" in str(refusal(doctor.write_report, path, []))
    doctor.write_report(path, [], overwrite=True)
