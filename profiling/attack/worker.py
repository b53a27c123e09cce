"""A process that runs one hostile input after the other as `lfpipe` would, within itself: thousands a minute.

Reads {"part", "number", "seed", "folder"} a line from stdin, answers an Outcome a line. Commands go through `lfpipe.cli.run`,
the entry of the real program. The parent ends a process that hangs; the kernel refuses one too much memory.
"""

import contextlib
import faulthandler
import io
import json
import os
import random
import resource
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import attrs

from profiling.attack import packs, paths, records, scenes
from profiling.attack.case import Case, Outcome, give_away, judged, rng_of

Make = Callable[[random.Random, Path, Path], Case]
PARTS: dict[str, Make] = {"scenes": scenes.make, "records": records.make, "packs": packs.make, "paths": paths.make}
MOST_BYTES = 6 << 30  # of address space: threads and maps take gigabytes of it without using them
NOBODY = 65534


def compare_reference(was: str, now: str) -> None:
    """What `lfpipe replay --expect` does after its session."""
    from lfpipe.errors import UserError
    from lfpipe.replay.budgets import Budget, broken
    from lfpipe.replay.compare import compare
    from lfpipe.replay.report import read_report

    try:
        found = compare(Path(was), Path(now))
        broken([Budget("latency.render.busy.p95_ms", "reference", 1e9, None, "")], read_report(Path(now)), read_report(Path(was)))
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    print(*found.notes, *found.differences, sep="\n")
    sys.exit(1 if found.differences else 0)


def run_cli(argv: list[str]) -> int:
    """`lfpipe argv` in this process; its exit code. What escapes it is printed as Python would."""
    import lfpipe.cli

    sys.argv = ["lfpipe", *argv]
    try:
        if argv[0] == "compare-reference":
            compare_reference(*argv[1:])
        lfpipe.cli.run()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


@contextlib.contextmanager
def _captured(folder: Path) -> Iterator[tuple[Path, Path]]:
    """stdout and stderr, of C libraries too, into files beside folder."""
    files = folder.with_suffix(".out"), folder.with_suffix(".err")
    streams = sys.stdout, sys.stderr
    kept = [os.dup(1), os.dup(2)]
    for number, path in enumerate(files, 1):
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        os.dup2(fd, number)
        os.close(fd)
    sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False), "utf-8", "strict", write_through=True)
    sys.stderr = io.TextIOWrapper(io.FileIO(2, "w", closefd=False), "utf-8", "backslashreplace", write_through=True)
    try:
        yield files
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        sys.stdout, sys.stderr = streams
        for number, fd in enumerate(kept, 1):
            os.dup2(fd, number)
            os.close(fd)


def _peak_mb() -> float:
    """The largest resident size since the last `_forget_peak`."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def _forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


@contextlib.contextmanager
def _as_nobody(folder: Path, wanted: bool) -> Iterator[None]:
    if not wanted or os.geteuid():
        yield
        return
    give_away(folder, NOBODY)
    os.setegid(NOBODY)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(0)


def one(part: str, number: int, seed: int, folder: Path, templates: Path) -> Outcome:
    """Makes an input in folder, runs it and says what came of it."""
    case = PARTS[part](rng_of(seed, part, number), folder, templates)
    folder.with_suffix(".case").write_text(json.dumps({"kind": case.kind, "argv": case.argv}))
    home = {"XDG_CACHE_HOME": "cache", "XDG_CONFIG_HOME": "settings", "XDG_RUNTIME_DIR": "run", "HOME": "."}
    os.environ.update({name: str(folder / value) for name, value in home.items()})
    (folder / "run").mkdir(mode=0o700)
    before = Path.cwd()
    began = time.monotonic()
    with _captured(folder) as (out, err):
        os.chdir(folder)
        _forget_peak()
        try:
            with _as_nobody(folder, case.unprivileged):
                code = run_cli(case.argv)
        finally:
            os.chdir(before)
        peak = _peak_mb()
    texts = [path.read_text(errors="replace") for path in (out, err)]
    return attrs.evolve(judged(case, folder, code, *texts, peak), argv=tuple(case.argv), seconds=time.monotonic() - began)


def main() -> None:
    """Serves until stdin ends. argv: folder of templates, seconds after which an input hangs."""
    templates, limit_s = Path(sys.argv[1]), float(sys.argv[2])
    answers = os.fdopen(os.dup(1), "w")
    null = os.open(os.devnull, os.O_RDONLY)
    requests = os.fdopen(os.dup(0))
    os.dup2(null, 0)
    os.environ.pop("DISPLAY", None)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    stacks = os.fdopen(os.open(sys.argv[3], os.O_WRONLY | os.O_CREAT | os.O_TRUNC), "w")
    faulthandler.enable(stacks)
    for name in (
        "scene",
        "sequence",
    ):  # imports what runs later without the right to read everything, Python's own files among it
        warm = templates.with_name(f"warm-{os.getpid()}")
        warm.mkdir()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.chdir(warm):
            os.environ["XDG_CACHE_HOME"] = str(warm)
            source = str(templates / ("hci" if name == "scene" else name))
            run_cli(["scene", "plan", source] if name == "scene" else ["sequence", "export", source, "warm.mkv"])
        shutil.rmtree(warm)
    print("ready", file=answers, flush=True)
    for line in requests:
        asked = json.loads(line)
        faulthandler.dump_traceback_later(limit_s, exit=True, file=stacks)
        found = one(asked["part"], asked["number"], asked["seed"], Path(asked["folder"]), templates)
        faulthandler.cancel_dump_traceback_later()
        print(json.dumps(attrs.asdict(found)), file=answers, flush=True)


if __name__ == "__main__":
    main()
