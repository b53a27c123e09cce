"""Draws the layers of packages and the imports between them: docs/imports.svg. A test keeps it
current.

python -m tools.draw_imports

A layer imports only layers below it (`lint-imports`). Its line crosses the arrow of each layer that
it imports, with a dot where it joins one.
"""

import argparse
import ast
import tomllib
from pathlib import Path

from tests.support.source import modules, package_of
from tools.svg import CORE, EXTRA, MEMORY, Box, figure, line, text

OUT = Path(__file__).parents[1] / "docs" / "imports.svg"
TOP_LEVEL = "top-level modules"  # errors, eyes and the like, below all packages
ROW, LANE, WIDTH, LEFT = 36, 32, 250, 14  # px: of a row, between two arrows, of a layer's box
COLOURS = ("#3e63dd", "#b25e09", "#218358", "#a144af", "#c62a2f", "#0d74a4")  # of arrows


def layers() -> list[set[str]]:
    """From the bottom up, as the first contract of [tool.importlinter] has them."""
    tool = tomllib.loads((OUT.parents[1] / "pyproject.toml").read_text())["tool"]
    contract = tool["importlinter"]["contracts"][0]
    return [
        {TOP_LEVEL},
        *(
            {name.removeprefix("lfpipe.") for name in layer.split(" | ")}
            for layer in reversed(contract["layers"])
        ),
    ]


def imports() -> set[tuple[int, int]]:
    """Pairs of a layer and one that it imports."""
    level = {package: i for i, packages in enumerate(layers()) for package in packages}
    found = set()
    for module, tree in modules().items():
        here = package_of(module) if "/" in module else TOP_LEVEL
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                words = node.module.split(".")
                if words[0] == "lfpipe" and not module.startswith("__"):
                    for name in words[1:2] or [one.name for one in node.names]:
                        found.add((level[here], level.get(name, 0)))
    return {(here, there) for here, there in found if here != there}


def drawn() -> str:
    """The text of the figure."""
    names = layers()
    arrows = imports()
    height = ROW * len(names) + 40
    boxes = [
        Box(
            x=LEFT + WIDTH / 2,
            y=height - ROW * (i + 0.5) - 34,
            width=WIDTH,
            height=ROW - 12,
            lines=(", ".join(sorted(packages)),),
            fill=EXTRA if "extras" in packages else MEMORY if i == 0 else CORE,
        )
        for i, packages in enumerate(names)
    ]
    lanes = {
        there: LEFT + WIDTH + LANE * (len(names) - there - 0.5) for there in range(len(names) - 1)
    }
    parts = [box.svg() for box in boxes]
    for here, box in enumerate(boxes):
        if targets := [there for one, there in arrows if one == here]:
            parts.append(
                line([(box.right, box.y - 7), (lanes[min(targets)], box.y - 7)], arrow=False)
            )
    for there, x in lanes.items():
        sources = [here for here, target in arrows if target == there]
        if sources:
            box = boxes[there]
            points = [(x, boxes[max(sources)].y - 7), (x, box.y + 7), (box.right, box.y + 7)]
            parts.append(line(points, colour=COLOURS[there % len(COLOURS)], width=1.8))
    for here, there in sorted(arrows):
        x, y = lanes[there], boxes[here].y - 7
        fill = COLOURS[there % len(COLOURS)]
        parts.append(f'<circle cx="{x:g}" cy="{y:g}" r="5" fill="{fill}"/>')
    note = "A dot: the layer in this row imports the layer that the arrow points to."
    parts.append(text((LEFT, height - 12), note, anchor="start"))
    return figure(lanes[0] + LANE / 2, height, "Layers of packages and their imports", parts)


if __name__ == "__main__":
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    OUT.write_text(drawn())
