"""Draws the rooms of the house and the imports between them, as a picture and in words.

    python -m tools.draw_imports [--root FOLDER] OUT.png

Arrows point from a room to one that it imports, as thick as the number of imports. Red: upwards, or
within a circle.
"""

import argparse
import ast
from collections import Counter
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def room(name: str) -> str:
    """The room of a file: its folder, or "root" of a loose module; "" for the package's own entry
    points.
    """
    _, here, *inside = name.split("/")
    return here if inside else "" if here.startswith("__") else "root"


def imports(files: dict[str, str]) -> Counter[tuple[str, str]]:
    """(room, imported room) -> number of imports."""
    rooms = {room(name) for name in files}
    arrows: Counter[tuple[str, str]] = Counter()
    for name, text in files.items():
        here = room(name)
        for node in ast.walk(ast.parse(text)):
            if (
                isinstance(node, ast.ImportFrom)
                and node.module
                and node.module.split(".")[0] == "lfpipe"
            ):
                words = node.module.split(".")
                for target in [words[1]] if len(words) > 1 else [one.name for one in node.names]:
                    there = (
                        target
                        if target in rooms
                        else "root"
                        if f"lfpipe/{target}.py" in files
                        else here
                    )
                    arrows[here, there] += here not in ("", there)
    return +arrows


def floors(arrows: Counter[tuple[str, str]]) -> dict[str, int]:
    """The floor of each room: one above the highest that it imports. Rooms within a circle share
    the floor above the rest.
    """
    rooms = {name for arrow in arrows for name in arrow}
    found: dict[str, int] = {}
    while left := rooms - found.keys():
        ready = {
            name for name in left if all(there in found for here, there in arrows if here == name)
        } or left
        found |= {
            name: 1
            + max((found.get(there, -1) for here, there in arrows if here == name), default=-1)
            for name in ready
        }
    return found


def draw(files: dict[str, str], out: Path) -> None:
    """Writes the picture and prints the same in words."""
    arrows = imports(files)
    floor = floors(arrows)
    lines: Counter[str] = Counter()
    for name, text in files.items():
        lines[room(name)] += text.count("\n")
    levels = [
        sorted(name for name in floor if floor[name] == level)
        for level in range(max(floor.values()) + 1)
    ]
    place = {
        name: ((i + 0.5) / len(level), n)
        for n, level in enumerate(levels)
        for i, name in enumerate(level)
    }
    metric, axes = plt.subplots(figsize=(10, 1.1 * len(levels) + 1))
    for (here, there), count in sorted(arrows.items()):
        up = floor[here] <= floor[there]
        style = {
            "color": "#e5484d" if up else "#8b8d98",
            "lw": 0.4 + count / 12,
            "alpha": 0.9 if up else 0.5,
        }
        axes.annotate(
            "",
            place[there],
            place[here],
            arrowprops={"arrowstyle": "-|>", "shrinkA": 14, "shrinkB": 14, **style},
        )
        print(f"{here:>10} -> {there:<10} {count:3}{'  upwards or in a circle' if up else ''}")
    for name, (x, y) in place.items():
        box = {"boxstyle": "round,pad=0.4", "fc": "white", "ec": "#3e63dd"}
        axes.text(
            x, y, f"{name}\n{lines[name]} lines", ha="center", va="center", fontsize=9, bbox=box
        )
    axes.set(xlim=(0, 1), ylim=(-0.6, len(levels) - 0.4))
    axes.axis("off")
    metric.savefig(out, dpi=110, bbox_inches="tight")
    print(f"{sum(lines.values())} lines, {len(files)} files; written to {out}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--root", type=Path, default=Path(__file__).parents[1], help="a checkout; default: this one"
    )
    parser.add_argument("out", type=Path, metavar="OUT.png")
    given = parser.parse_args()
    draw(
        {
            str(path.relative_to(given.root)): path.read_text()
            for path in (given.root / "lfpipe").rglob("*.py")
        },
        given.out,
    )
