"""Packs in the cache, altered after they were made; the commands that open and list them."""

import random
import shutil
import struct
from pathlib import Path

from profiling.attack import mutations
from profiling.attack.case import Case

HEADS = (
    "{'descr': '|u1', 'fortran_order': False, 'shape': (1, 3, 3, 3, 20000, 20000), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
    "{'descr': '|u1', 'fortran_order': True, 'shape': (1, 3, 3, 3, 24, 32), }", "{'descr': '|u1', 'shape': ()}",
    "{'descr': '|u1', 'fortran_order': False, 'shape': (-1,), }", "__import__('os').abort()", "[" * 500,
    "{'descr': '|V0', 'fortran_order': False, 'shape': (1, 3, 3, 3, 24, 32), }",
    "{'descr': '|u1', 'fortran_order': False, 'shape': (99999999999999999999,), }",
)  # fmt: skip


def _npy(rng: random.Random) -> bytes:
    """An array file with a hostile head."""
    head = rng.choice(HEADS).encode()
    version = rng.choice((1, 2, 3, 9))
    size = rng.choice((len(head), 0, 65_535))
    return (
        b"\x93NUMPY"
        + bytes((version, 0))
        + (struct.pack("<H", size) if version == 1 else struct.pack("<I", rng.choice((size, 2**32 - 1))))
        + head
        + bytes(100)
    )


def make(rng: random.Random, folder: Path, templates: Path) -> Case:
    """One altered pack of the scene at templates/hci, in folder/cache."""
    cache = folder / "cache" / "lfpipe"
    shutil.copytree(templates / "packed" / "lfpipe", cache)
    pack = next(path for path in (cache / "scenes").iterdir() if not path.name.startswith("."))
    victims = [*pack.iterdir()]
    path = rng.choice([*victims, pack / "manifest.json", pack / "manifest.json", *(cache / "index").iterdir()])
    kind = rng.randrange(6)
    what = path.name if path.parent == pack else "index"
    if kind == 0:
        what += f": a {mutations.changed_kind(rng, path)}"
    elif kind == 1 and path.suffix == ".npy":
        path.write_bytes(_npy(rng))
        what += ": head"
    elif path.suffix == ".json":
        path.write_bytes(mutations.changed_json(rng, mutations.read(path)))
    elif what == "index" and kind < 4:
        path.write_bytes(
            rng.choice((b"../../..", b"/etc", b"", b"\xff", b"x" * 100_000, b"..", b".", pack.name.encode() + b"\n"))
        )
    elif kind == 5 and rng.random() < 0.1:
        mutations.grown(rng, path)
    else:
        path.write_bytes(mutations.changed_bytes(rng, mutations.read(path)))
    scene = str(templates / "hci")
    argv = rng.choices(
        (
            ["scene", "info", "--json", scene],
            ["scene", "pack", "--json", scene],
            ["scene", "list", "--json"],
            ["scene", "list"],
            ["scene", "clean"],
            ["scene", "clean", "--all"],
            ["scene", "plan", "--json", scene],
            ["scene", "view", scene, "--row", "1", "--col", "1", "-o", "out.png"],
        ),
        (8, 3, 3, 2, 1, 1, 1, 2),
    )[0]  # fmt: skip
    return Case(f"pack: {what}", argv, ("out*", "cache/lfpipe/scenes/.*"))
