"""What a change that only removes must not change, as one file that two versions compare:

    python -m tools.baseline OUT.json [--before EARLIER.json] [--quick]

Digests of packs, recordings and replays, errors of the benchmarks, the help of every command and
the sizes; all through the command line. --before prints each difference and exits with 1. --quick:
without the benchmarks.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from lfpipe.cli import cli
from tools.count_constants import by_package as constants
from tools.count_statements import by_package as statements

ROOT = Path(__file__).parents[1]
SCENES = ROOT.parent / "shared" / "data" / "lightfields"
CASES = ROOT.parent / "shared" / "cases"
DEMOS = ("still-life", "marbles", "meadow")
# Of a manifest: what depends on the run, the place of the cache and the version.
UNSTEADY = {
    "pack",
    "key",
    "source",
    "created",
    "lfpipe",
    "version",
    "costs",
    "pack_s",
    "files",
    "checksum",
}
REPLAYS = {
    "default": (),
    "paper": ("--config=paper",),
    "one-euro": ("--set=track.filter=one-euro",),
    "mean, blend, gamma": (
        "--set=track.filter=mean",
        "--set=render.method=blend",
        "--set=render.light=gamma",
    ),
    "warp, colour": ("--set=render.method=warp", "--set=render.anaglyph=colour"),
}


def run(*words: str | Path) -> str:
    """What `lfpipe WORDS` prints; its exit code is the first line where it is not 0."""
    done = subprocess.run(
        [sys.executable, "-m", "lfpipe", *map(str, words)], capture_output=True, text=True
    )
    return done.stdout if done.returncode == 0 else f"{done.returncode}\n{done.stderr}"


def digest(*paths: Path) -> str:
    """Of files, in the order given."""
    hashed = hashlib.sha256()
    for path in paths:
        hashed.update(path.read_bytes())
    return hashed.hexdigest()[:16]


def help_texts(command: click.Command, *path: str) -> Iterator[tuple[str, str]]:
    """The help of a command and of all below it."""
    context = click.Context(command, info_name=" ".join(("lfpipe", *path)), terminal_width=80)
    yield f"help {' '.join(path)}", command.get_help(context)
    if not isinstance(command, click.Group):
        return
    for name in command.list_commands(context):
        below = command.get_command(context, name)
        assert below is not None
        yield from help_texts(below, *path, name)


def packed(scene: str) -> dict[str, Any]:
    """What a pack is: its manifest and the digest of its arrays."""
    printed = run("scene", "pack", scene, "--json")
    try:
        manifest: dict[str, Any] = json.loads(printed)
    except ValueError:
        return {"refused": printed}
    arrays = digest(*sorted(Path(manifest["pack"]).glob("*.npy")))
    return {"arrays": arrays} | {k: v for k, v in manifest.items() if k not in UNSTEADY}


def replayed(folder: Path) -> Iterator[tuple[str, Any]]:
    """The digests of a face in known motion: its recording, and its replays by the table."""
    walk, sequence = folder / "walk.avi", folder / "walk"
    make = [sys.executable, "-m", "tools.make_sequence", str(walk.with_suffix("")), "--seconds=4"]
    subprocess.run(make, check=True, cwd=ROOT, capture_output=True)
    run("sequence", "import", walk, sequence)
    yield "recording", digest(*sorted(sequence.glob("frames.*")))
    for name, options in REPLAYS.items():
        for scene in ("demo:still-life", *map(str, sorted(SCENES.glob("hci_*"))[:1])):
            out = folder / f"{name}, {Path(scene).name}"
            run("replay", sequence, "--scene", scene, "--out", out, *options)
            report = json.loads((out / "report.json").read_text())
            kept = {key: report[key] for key in ("plan", "counts", "digests")}
            yield f"replay {out.name}", kept


def errors(results: Path) -> Iterator[tuple[str, float]]:
    """Every value of a benchmark that is no time."""
    for name, benchmark in json.loads(results.read_text())["benchmarks"].items():
        for table in benchmark["tables"]:
            for row in table["rows"]:
                for key, cell in row["values"].items():
                    if not key.endswith(("_ms", "_us", "_s")) and cell["value"] is not None:
                        place = f"{name} {table['of']} {row['name']} {key}"
                        yield place, round(cell["value"], 6)


def measured(folder: Path) -> Iterator[tuple[str, Any]]:
    """Errors of the benchmarks on shared scenes and simulated viewers, and the bounds' outcome."""
    scenes = sorted(SCENES.iterdir())
    commands: dict[str, tuple[str | Path, ...]] = {
        "viewer": ("viewer", "--quick", "--check"),
        "synthesis": ("synthesis", "--quick", "--scene", SCENES / "hci_antinous"),
        "table": ("table", "--untimed", *(path for path in scenes if path.is_dir())),
    }
    for name, words in commands.items():
        printed = run("bench", *words, "--out", folder / name)
        yield f"{name} passes", not printed.startswith(("1\n", "2\n"))
        yield from errors(folder / name / "results.json")


def frozen(quick: bool) -> dict[str, Any]:
    """All of it, by name."""
    found: dict[str, Any] = {f"statements {k}": v for k, v in sorted(statements().items())}
    found |= {f"constants {k}": v for k, v in sorted(constants().items())}
    found |= help_texts(cli)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind in ("CACHE", "CONFIG", "STATE", "DATA", "RUNTIME"):
            place = folder / kind
            place.mkdir(mode=0o700)
            os.environ[f"XDG_{kind}_{'DIR' if kind == 'RUNTIME' else 'HOME'}"] = str(place)
        demos = [f"demo:{demo}" for demo in DEMOS]
        for scene in (*demos, *map(str, sorted(SCENES.iterdir()) + sorted(CASES.iterdir()))):
            found[f"pack {Path(scene).name}"] = packed(scene)
        found |= replayed(folder)
        found |= {} if quick else measured(folder)
    return found


def differences(was: dict[str, Any], now: dict[str, Any]) -> Iterator[str]:
    """One line for each."""
    for name in sorted(was.keys() | now.keys()):
        before, after = was.get(name), now.get(name)
        if before == after:
            continue
        if isinstance(before, dict) and isinstance(after, dict):
            yield from (f"{name}: {line}" for line in differences(before, after))
        else:
            yield f"{name}: {before} -> {after}"


def main() -> int:
    """Writes the file, and compares it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--quick", action="store_true", help="without the benchmarks")
    chosen = parser.parse_args()
    now = json.loads(json.dumps(frozen(chosen.quick)))
    chosen.out.write_text(json.dumps(now, indent=1) + "\n")
    found = list(differences(json.loads(chosen.before.read_text()), now) if chosen.before else ())
    print("\n".join(found) or f"{len(now)} entries, no difference")
    return int(bool(found))


if __name__ == "__main__":
    raise SystemExit(main())
