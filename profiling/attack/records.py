"""Sequences, traces, reports, results, configurations and budgets, damaged; the commands that read them."""

import hashlib
import json
import random
import shutil
from pathlib import Path

from profiling.attack import mutations
from profiling.attack.case import Case
from profiling.attack.headers import claiming

RESULTS = Path(__file__).parents[1] / "results" / "bench-quick"


def _checksums(folder: Path) -> None:
    """Makes the checksums of a manifest right again, so that what lies behind them is reached."""
    if folder / "manifest.json" not in mutations.files_in(folder):
        return
    try:
        manifest = json.loads((folder / "manifest.json").read_bytes())
        for path in mutations.files_in(folder):
            if path.name in manifest["checksums"]:
                manifest["checksums"][path.name] = hashlib.sha256(mutations.read(path)).hexdigest()
        (folder / "manifest.json").write_text(json.dumps(manifest))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return


def _damage(rng: random.Random, path: Path) -> str:
    """Does one thing to a file."""
    if rng.random() < 0.1:
        return f"a {mutations.changed_kind(rng, path)} for {path.name}"
    data = mutations.read(path)
    if rng.random() < 0.02:
        mutations.grown(rng, path)
        return f"{path.name}: grown"
    if path.suffix in (".json", ".jsonl"):
        path.write_bytes(mutations.changed_json(rng, data))
    elif path.suffix in (".csv", ".toml") and rng.random() < 0.7:
        path.write_bytes(mutations.changed_numbers(rng, data))
    elif path.name == "frames.bin" and rng.random() < 0.3:
        path.write_bytes(claiming(rng, rng.choice((".png", ".jpg"))) + data)
    else:
        path.write_bytes(mutations.changed_bytes(rng, data))
    return path.name


def sequence(rng: random.Random, folder: Path, templates: Path) -> Case:
    """A damaged sequence, and a command that reads it."""
    made = folder / "sequence"
    shutil.copytree(templates / "sequence", made)
    kind = _damage(rng, rng.choice(mutations.files_in(made)))
    if rng.random() < 0.6:
        _checksums(made)
    unprivileged = rng.random() < 0.05
    if unprivileged:
        victim = rng.choice([made, *made.iterdir()])
        if not victim.is_symlink():
            victim.chmod(0)
        kind = "permissions"
    argv = rng.choice(
        (
            ["sequence", "info", "--json", "sequence"],
            ["sequence", "info", "sequence"],
            ["sequence", "check", "sequence"],
            ["sequence", "check", "sequence"],
            ["sequence", "cut", "sequence", "out", "--from", "0", "--to", rng.choice(("0.1", "1e400", "nan", "0"))],
            ["sequence", "export", "sequence", "out.mkv"],
            ["sequence", "import", "sequence/frames.bin", "out"],
            ["replay", "sequence", "--expect", "nowhere"],
        )
    )  # fmt: skip
    return Case(f"sequence: {kind}", argv, ("out*",), unprivileged=unprivileged)


def trace(rng: random.Random, folder: Path, templates: Path) -> Case:
    """A damaged trace, to be converted."""
    shutil.copytree(templates / "trace", folder / "t")
    kind = _damage(rng, folder / "t" / "trace.jsonl")
    return Case(f"trace: {kind}", ["trace", "convert", "t/trace.jsonl", "out.json"], ("out*",))


def reference(rng: random.Random, folder: Path, templates: Path) -> Case:
    """A damaged reference, which a replay compares with: by `lfpipe.replay.compare`, without the session before it."""
    for name in ("was", "now"):
        shutil.copytree(templates / "reference", folder / name)
    victim = rng.choice([path for path in mutations.files_in(folder / "was") if path.suffix != ".png"])
    kind = _damage(rng, victim)
    return Case(f"report: {kind}", ["compare-reference", "was", "now"], (), codes=(0, 1, 2))


def results(rng: random.Random, folder: Path, _templates: Path) -> Case:
    """Damaged results of `lfpipe bench`, compared with whole ones."""
    for name in ("a", "b"):
        (folder / name).mkdir()
        for path in RESULTS.glob("*.json"):
            shutil.copyfile(path, folder / name / path.name)
    victims = mutations.files_in(folder / "a")
    kind = _damage(rng, rng.choice(victims))
    return Case(f"results: {kind}", ["bench", "compare", "--json", "a", "b"], (), codes=(0, 1, 2))


def configuration(rng: random.Random, folder: Path, templates: Path) -> Case:
    """A damaged config.toml, as a file and as the user's own."""
    shutil.copyfile(templates / "config" / "config.toml", folder / "config.toml")
    data = (folder / "config.toml").read_bytes()
    if rng.random() < 0.5:
        line = rng.choice(
            (
                "[render]\n",
                "render = 5\n",
                "[[render]]\n",
                '"" = 1\n',
                "a.b.c.d = 1\n",
                "[render.alpha_px]\nx = 1\n",
                "x = 1979-05-27T07:32:00Z\n",
                "x = [" * 3000 + "\n",
                f"[camera]\nwidth_px = {rng.choice(mutations.NUMBERS)[:300]}\n",
                '[camera]\nsource = "a\\u0000b"\n',
                "\ufeff[render]\n",
                *(f"k{n} = 1\n" * 1 for n in range(2)),
                "".join(f"k{n} = 1\n" for n in range(4000)),
                "[" + ".".join("a" * 500) + "]\n",
                "x = 0x" + "f" * 5000 + "\n",
                '[camera]\n"\\u001b[31m" = 1\n',
                f'[scene]\nlayout = "{"x" * 100_000}"\n',
            )
        )  # fmt: skip
        (folder / "config.toml").write_bytes(line.encode("utf-8", "surrogatepass") + (data if rng.random() < 0.3 else b""))
        kind = "lines"
    else:
        live = b"\n".join(line.removeprefix(b"# ") if b" = " in line else line for line in data.splitlines())
        (folder / "config.toml").write_bytes(live)
        kind = _damage(rng, folder / "config.toml")
    argv = rng.choice(
        (
            ["config", "check", "config.toml"],
            ["config", "show", "--config", "config.toml"],
            ["scene", "list", "--json", "--config", "config.toml"],
        )
    )
    return Case(f"configuration: {kind}", argv)


def settings(rng: random.Random, _folder: Path, _templates: Path) -> Case:
    """--set with odd keys and values."""
    from lfpipe.config import options

    key = rng.choice([*options(), "render", "", "a.b.c", "render.", ".x", "render.alpha_px.x", "é", "camera.width_px "])
    value = rng.choice(
        (
            *mutations.NUMBERS,
            *(word.replace("\0", "") for word in mutations.WORDS),
            "[]",
            "{}",
            '"x"',
            "true",
            "auto",
            "[" * 2000,
            "1979-05-27",
            "{a=1}",
        )
    )  # fmt: skip
    value = value.encode("utf-8", "surrogatepass").decode("utf-8", "surrogateescape")[:50_000]
    return Case("--set", ["config", "show", f"--set={key}{rng.choice(('=', '=', '=', '', '=='))}{value}"])


def budget(rng: random.Random, folder: Path, templates: Path) -> Case:
    """A damaged file of budgets; the replay ends before its session, for want of a reference."""
    shutil.copytree(templates / "budget", folder / "b")
    shutil.copytree(templates / "sequence", folder / "sequence")
    kind = _damage(rng, folder / "b" / "budget.toml")
    return Case(f"budget: {kind}", ["replay", "sequence", "--budget", "b/budget.toml", "--expect", "nowhere"], ("nowhere",))


PARTS = {"sequence": 40, "trace": 15, "reference": 15, "results": 8, "configuration": 12, "settings": 7, "budget": 3}


def make(rng: random.Random, folder: Path, templates: Path) -> Case:
    """One of PARTS, by its weight."""
    name = rng.choices(list(PARTS), list(PARTS.values()))[0]
    made: Case = globals()[name](rng, folder, templates)
    return made
