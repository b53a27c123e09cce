"""A sample of the inputs through the real command line, each a process of its own: exit code, words, and its peak of memory."""

import os
import resource
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import attrs

from profiling.attack.book import Book
from profiling.attack.case import HELD, Case, Outcome, judged, rng_of
from profiling.attack.pool import LIMIT_S, kept

FIRST = 1_000_000  # numbers of inputs that only go this way


def make(part: str, number: int, seed: int, folder: Path, templates: Path) -> Case:
    """The case of a number, made in folder."""
    from profiling.attack.worker import PARTS

    return PARTS[part](rng_of(seed, part, number), folder, templates)


def _ended(process: subprocess.Popen[bytes]) -> tuple[int, float, bool]:
    """(exit code, peak of memory in MB of it and its children, whether it hung)."""
    end = time.monotonic() + LIMIT_S * 2
    while time.monotonic() < end:
        pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            return os.waitstatus_to_exitcode(status), usage.ru_maxrss / 1024, False
        time.sleep(0.02)
    process.kill()
    _, _, usage = os.wait4(process.pid, 0)
    return -9, usage.ru_maxrss / 1024, True


def command(case: Case, folder: Path) -> Outcome:
    """Runs `lfpipe argv` in folder."""
    (folder / "run").mkdir(mode=0o700, exist_ok=True)
    home = {"XDG_CACHE_HOME": "cache", "XDG_CONFIG_HOME": "settings", "XDG_RUNTIME_DIR": "run", "HOME": "."}
    env = {
        **os.environ,
        **{name: str(folder / value) for name, value in home.items()},
        "PYTHONPATH": str(Path(__file__).parents[2]),
    }
    with (folder.with_suffix(".out")).open("wb") as out, (folder.with_suffix(".err")).open("wb") as err:
        process = subprocess.Popen(
            [sys.executable, "-m", "lfpipe", *case.argv],
            cwd=folder,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30)),
        )
        code, peak, hung = _ended(process)
    if hung:
        return Outcome(case.kind, "hang", f"hang of {' '.join(case.argv[:2])}", "", peak, tuple(case.argv))
    texts = [folder.with_suffix(suffix).read_text(errors="replace") for suffix in (".out", ".err")]
    return attrs.evolve(judged(case, folder, code, *texts, peak), argv=tuple(case.argv))


def run(book: Book, part: str, count: int, work: Path, templates: Path, workers: int) -> None:
    """count inputs of a part, in processes of their own."""
    numbers, lock = iter(range(FIRST, FIRST + count)), threading.Lock()

    def serve(index: int) -> None:
        while True:
            with lock:
                number = next(numbers, None)
            if number is None:
                return
            folder = work / f"command-{index}"
            folder.mkdir()
            case = make(part, number, book.seed, folder, templates)
            if case.unprivileged or case.argv[0] == "compare-reference":
                shutil.rmtree(folder)
                continue
            found = command(case, folder)
            with lock:
                repeat = "" if found.outcome in HELD or not book.wants(found) else kept(folder, book, part, number, found)
                book.add(f"{part}, command line", attrs.evolve(found, kind=" ".join(case.argv[:2])), number, repeat)
            shutil.rmtree(folder, ignore_errors=True)

    threads = [threading.Thread(target=serve, args=(index,)) for index in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
