"""Runs the attack: `uv run python -m profiling.attack [--quick] [--seed N] [--out FILE] [--part NAME]...`."""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from profiling.attack import pool
from profiling.attack.book import Book

COUNTS = {"ctl": 62_000, "page": 10_000, "scenes": 20_000, "records": 10_000, "packs": 3_000, "paths": 1_000}
QUICK = {"ctl": 700, "page": 150, "scenes": 120, "records": 100, "packs": 30, "paths": 30}
FILES = ("scenes", "records", "packs", "paths")


def make_templates(to: Path, replayed: bool) -> None:
    """Valid inputs, among them what only the program itself makes: a pack, and the results of a replay."""
    script = "from pathlib import Path; from profiling.attack.templates import make_all; make_all(Path({!r}))"
    subprocess.run([sys.executable, "-c", script.format(str(to))], check=True)
    (to / "run").mkdir(mode=0o700)
    env = {
        **os.environ,
        "XDG_CACHE_HOME": str(to / "packed"),
        "XDG_CONFIG_HOME": str(to / "settings"),
        "XDG_RUNTIME_DIR": str(to / "run"),
    }
    scene = str(to / "hci")
    sets = ["--set", "camera.width_px=32", "--set", "camera.height_px=24"]
    commands = [
        ["scene", "pack", scene],
        ["replay", str(to / "sequence"), "--scene", scene, "--out", str(to / "reference"), *sets],
    ]
    for words in commands if replayed else commands[:1]:
        subprocess.run([sys.executable, "-m", "lfpipe", *words], check=True, env=env, stdout=subprocess.DEVNULL)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="some 1,100 inputs, half a minute")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="where the table goes")
    parser.add_argument("--part", action="append", choices=list(COUNTS), help="only these; repeatable")
    parser.add_argument("--count", type=int, help="inputs of each part")
    parser.add_argument("--only", type=int, help="one input of a part, by its number")
    parser.add_argument("--failures", type=Path, help="where failed inputs are kept")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    args = parser.parse_args()
    from profiling.attack import commands, ctl, page, report

    failures = args.failures or Path(tempfile.mkdtemp(prefix="lfpipe-attack-"))
    failures.mkdir(parents=True, exist_ok=True)
    book = Book(args.seed, failures)
    counts = QUICK if args.quick else COUNTS
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None  # a disk would be most of the time
    with tempfile.TemporaryDirectory(prefix="lfattack", dir=memory, ignore_cleanup_errors=True) as name:
        work = Path(name)
        work.chmod(0o711)
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes start: each would compile everything anew
        os.environ["PYTHONPYCACHEPREFIX"] = str(work / "compiled")
        make_templates(work / "templates", "records" in (args.part or counts))
        chosen = [part for part in counts if part in (args.part or counts)]

        def lane(parts: list[str]) -> None:
            """Runs parts one after the other."""
            for part in parts:
                began = time.monotonic()
                numbers = [args.only] if args.only is not None else range(args.count or counts[part])
                if part in FILES:
                    pool.run(book, part, iter(numbers), work, work / "templates", args.workers)
                    sample = 0 if args.only is not None else max(4, len(numbers) // 60)
                    commands.run(book, part, sample, work, work / "templates", args.workers)
                else:
                    {"ctl": ctl, "page": page}[part].run(book, len(numbers), work)
                book.seconds[part] = time.monotonic() - began
                print(f"{part}: {book.seconds[part]:.0f} s, {book.failed} failures so far", file=sys.stderr, flush=True)

        lanes = [[part for part in chosen if part not in FILES], [part for part in chosen if part in FILES]]
        with ThreadPoolExecutor(2) as threads:  # a session takes so many messages a second, and leaves time for files
            for done in [threads.submit(lane, parts) for parts in lanes]:
                done.result()
    text = report.table(book)
    print(text)
    if args.out:
        args.out.write_text(text)
    return 1 if book.failed else 0


if __name__ == "__main__":
    sys.exit(main())
