"""Paths that odd people have, given to every command that takes one."""

import os
import random
import shutil
from pathlib import Path

from profiling.attack import mutations
from profiling.attack.case import Case

DEVICES = (
    "/dev/null", "/dev/zero", "/dev/full", "/dev/stdin", "/dev/fd/0", "/proc/self/mem", "/proc/self/environ", "/proc/1/root",
    "/proc/self/fd", "/sys", "/", ".", "..", "",
)  # fmt: skip
TAKERS = (
    ("scene", ["scene", "info", "--json", "{}"]), ("scene", ["scene", "pack", "--json", "{}"]),
    ("scene", ["scene", "info", "{}"]), ("scene", ["scene", "view", "scene", "--row", "1", "--col", "1", "-o", "{}"]),
    ("scene", ["scene", "sheet", "scene", "-o", "{}"]), ("sequence", ["sequence", "info", "--json", "{}"]),
    ("sequence", ["sequence", "check", "{}"]), ("sequence", ["sequence", "info", "{}"]),
    ("sequence", ["sequence", "cut", "scene", "{}"]), ("sequence", ["sequence", "export", "scene", "{}"]),
    ("sequence", ["sequence", "import", "{}", "out"]), ("trace/trace.jsonl", ["trace", "convert", "{}", "out.json"]),
    ("trace/trace.jsonl", ["trace", "convert", "scene", "{}"]), ("config/config.toml", ["config", "check", "{}"]),
    ("config/config.toml", ["config", "show", "--config", "{}"]), ("config/config.toml", ["config", "init", "{}"]),
    ("sequence", ["replay", "{}", "--expect", "nowhere"]), ("sequence", ["replay", "scene", "--expect", "{}"]),
    ("budget/budget.toml", ["replay", "scene", "--budget", "{}", "--expect", "nowhere"]),
    ("scene", ["bench", "compare", "{}", "{}"]), ("scene", ["scene", "list", "--json", "--set", "scene.cache_dir={}"]),
    ("scene", ["scene", "pack", "scene", "--set", "scene.cache_dir={}"]),
    ("scene", ["up", "{}", "--camera", "file:nowhere", "--display", "none"]),
    ("sequence", ["up", "nowhere", "--camera", "file:{}", "--display", "none"]),
    ("scene", ["monitor", "--once", "--session", "{}"]), ("scene", ["scene", "clean", "{}"]),
    ("scene", ["ctl", "--session", "{}", "status"]),
)  # fmt: skip


def make(rng: random.Random, folder: Path, templates: Path) -> Case:
    """A valid thing under an odd name, or an odd path with nothing at it."""
    what, words = rng.choice(TAKERS)
    base, inner = what.partition("/")[::2]
    source = templates / ("hci" if base == "scene" else base) / inner
    first = templates / ("sequence" if words[0] in ("sequence", "replay") else "trace" if words[0] == "trace" else "hci")
    if "scene" in words[1:]:
        wanted = first if first.name != "trace" else first / "trace.jsonl"
        (shutil.copytree if wanted.is_dir() else shutil.copyfile)(wanted, folder / "scene")
    kind = rng.randrange(5)
    if kind == 0:
        path = os.fsencode(
            rng.choice((*DEVICES, "x" * 5000, "a/" * 3000, "//" * 50, "a" * 256, "scene/../scene/.", "scene/", "./scene"))
        )
    elif kind == 1:
        path = mutations.odd_name(rng)
    else:
        name = mutations.odd_name(rng)
        path = os.path.join(b"odd", name)  # noqa: PTH118
        (folder / "odd").mkdir()
        try:
            target = Path(os.fsdecode(os.path.join(os.fsencode(folder), path)))  # noqa: PTH118
            if not os.path.lexists(target):
                (shutil.copytree if source.is_dir() else shutil.copyfile)(source, target)
        except OSError:
            return Case("paths: no such name", ["scene", "info", os.fsdecode(path)])
    argv = [word.replace("{}", os.fsdecode(path)) for word in words]
    return Case(
        f"paths: {' '.join(words[:2])}", argv, ("nowhere",), codes=(0, 1, 2) if words[:2] == ["bench", "compare"] else (0, 2)
    )
