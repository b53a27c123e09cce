"""Worker processes that run hostile inputs; what hangs or crashes one is noted, and another takes its place."""

import contextlib
import json
import os
import selectors
import shutil
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from profiling.attack.book import Book
from profiling.attack.case import HELD, Outcome

LIMIT_S = 60.0  # an input takes a tenth of a second where nothing else runs
TURNS = 1000  # inputs after which a worker is replaced: what libraries keep is not an input's fault
FRESH_MB = 230.0  # so much left over from others, too


class Worker:
    """One process, for one thread."""

    def __init__(self, templates: Path, stacks: Path) -> None:
        self.turns, self.stacks = 0, stacks
        command = [sys.executable, "-m", "profiling.attack.worker", str(templates), str(LIMIT_S), str(stacks)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def ask(self, part: str, number: int, seed: int, folder: Path) -> Outcome:
        """The outcome of one input; of a process that ended or hung over it, too."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.turns += 1
        self.process.stdin.write(json.dumps({"part": part, "number": number, "seed": seed, "folder": str(folder)}) + "\n")
        self.process.stdin.flush()
        with selectors.DefaultSelector() as answer:  # not select: with 1,200 idle connections open, numbers exceed 1,024
            answer.register(self.process.stdout, selectors.EVENT_READ)
            line = self.process.stdout.readline() if answer.select(LIMIT_S + 20) else ""
        if line:
            found = json.loads(line)
            return Outcome(**{**found, "argv": tuple(found["argv"])})
        self.process.kill()
        code = self.process.wait()
        stack = self.stacks.read_text()
        places = [text.strip() for text in stack.splitlines() if "/lfpipe/" in text and "cli/" not in text]
        where = next(iter(places or [text.strip() for text in stack.splitlines() if "/lfpipe/" in text]), "?")
        case = folder.with_suffix(".case")
        about = json.loads(case.read_text()) if case.exists() else {"kind": part, "argv": []}
        more = {"detail": stack[:3000], "argv": tuple(about["argv"])}
        if "Timeout" in stack or code == -9:
            return Outcome(about["kind"], "hang", f"hang in {where}", **more)
        return Outcome(about["kind"], "traceback", f"a worker ended with {code} in {where}", **more)

    def end(self) -> None:
        """Ends the process."""
        with contextlib.suppress(OSError):
            assert self.process.stdin is not None
            self.process.stdin.close()
        self.process.kill()
        self.process.wait()


def copied(folder: Path, target: Path) -> None:
    """A copy of folder, with its FIFOs and links, and holes for what is large. Devices and sockets become empty files."""
    target.mkdir()
    for path in folder.iterdir():
        to, mode = target / path.name, path.lstat().st_mode
        if path.is_symlink():
            to.symlink_to(path.readlink())
        elif stat.S_ISDIR(mode):
            copied(path, to)
        elif stat.S_ISFIFO(mode):
            os.mkfifo(to)
        elif stat.S_ISREG(mode):
            with path.open("rb") as stream:
                to.write_bytes(stream.read(1 << 22))
            os.truncate(to, path.stat().st_size)
        else:
            to.touch()


def kept(folder: Path, book: Book, part: str, number: int, outcome: Outcome) -> str:
    """Moves a failed input to where failures are kept, with the command that repeats it."""
    target = book.failures / f"{part}-{number}"
    shutil.rmtree(target, ignore_errors=True)
    copied(folder, target)
    home = 'XDG_CACHE_HOME="$PWD/cache" XDG_CONFIG_HOME="$PWD/settings" XDG_RUNTIME_DIR="$PWD/run"'
    (target / "REPEAT.txt").write_text(
        f"cd here and run, or `python -m profiling.attack --part {part} --only {number} --seed {book.seed}`:\n"
        f"{home} lfpipe {' '.join(map(repr, outcome.argv))}\n\n{outcome.outcome}: {outcome.group}\n{outcome.detail}\n",
        errors="backslashreplace",
    )
    return str(target)


def run(book: Book, part: str, numbers: Iterator[int], work: Path, templates: Path, workers: int) -> None:
    """Runs inputs of one part until numbers end; outcomes go into book."""
    lock = threading.Lock()

    def serve(index: int) -> None:
        worker: Worker | None = None
        while True:
            with lock:
                number = next(numbers, None)
            if number is None:
                break
            if worker is None:
                worker = Worker(templates, work / f"stacks-{index}")
            folder = work / f"case-{index}-{number}"  # a process of the case before may still write into that one's
            folder.mkdir()
            folder.with_suffix(".case").unlink(missing_ok=True)
            found = worker.ask(part, number, book.seed, folder)
            if found.outcome not in HELD:
                with lock:
                    repeat = kept(folder, book, part, number, found) if book.wants(found) else ""
                    book.add(part, found, number, repeat)
            else:
                with lock:
                    book.add(part, found, number)
            shutil.rmtree(folder, ignore_errors=True)
            if worker.process.poll() is not None or worker.turns >= TURNS or found.peak_mb > FRESH_MB:
                worker.end()
                worker = None
        if worker is not None:
            worker.end()

    with ThreadPoolExecutor(workers) as threads:
        for done in [threads.submit(serve, index) for index in range(workers)]:
            done.result()  # an error of the harness must not pass for inputs that held
