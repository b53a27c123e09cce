"""Every import between the rooms of the house points down: nobody knows what stands above, and stages do not know each other."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import lfpipe

HOUSE = Path(lfpipe.__file__).parent
# From the ground up; rooms on one floor do not know each other. What is no room (`errors`, `eyes`, ...) is the ground itself.
FLOORS = (
    {"host"},
    {"config"},
    {"transport"},
    {"scene", "sequence"},
    {"capture", "track", "render"},
    {"supervisor"},
    {"replay", "observe"},
    {"bench"},
    {"cli"},
)
FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
GROUND_ON_CONFIG = {"quality"}  # what is no room and yet stands on one


def imported(path: Path) -> Iterator[str]:
    """Names of the parts of lfpipe that a file imports, at its head or within a function."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield from (f"{node.module}.{one.name}" for one in node.names)
        elif isinstance(node, ast.Import):
            yield from (one.name for one in node.names)


def room(path: Path) -> str:
    return path.relative_to(HOUSE).with_suffix("").parts[0]


def test_every_folder_is_a_room_with_its_floor() -> None:
    folders = {entry.name for entry in HOUSE.iterdir() if entry.is_dir() and any(entry.glob("*.py"))}
    assert folders == set(FLOOR)


def test_imports_point_down() -> None:
    wrong = []
    for path in HOUSE.rglob("*.py"):
        here = room(path)
        if here in ("__init__", "__main__"):
            continue
        for name in imported(path):
            words = name.split(".")
            there = words[1] if words[0] == "lfpipe" and len(words) > 1 else here
            if there == here or there not in FLOOR:
                continue
            below = FLOOR[there] < FLOOR[here] if here in FLOOR else here in GROUND_ON_CONFIG and there == "config"
            if not below:
                wrong.append(f"{path.relative_to(HOUSE)}: {name}")
    assert not wrong, "\n".join(wrong)
