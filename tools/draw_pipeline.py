"""Draws the processes, rings and control messages of a session, from the process table and the
rings: docs/pipeline.svg and, for README, docs/pipeline_small.svg. A test keeps both current.

python -m tools.draw_pipeline
"""

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path

from lfpipe.config import Config, SessionOptions
from lfpipe.supervisor.process_table import ON_DEMAND, SHOWN_BY, SOURCE, STAGES, rings
from lfpipe.transport.context import Stage
from lfpipe.transport.ring import RingSpec
from tools.svg import CORE, EXTRA, MEMORY, OUTSIDE, Box, figure, line, text

DOCS = Path(__file__).parents[1] / "docs"
# what each stage does, below its name
WORK = {
    "capture": "camera, file, demo",
    "track": "face engine, filter",
    "render": "synthesis, anaglyph",
    "views": "camera, program",
    "disparity": "of the views in need",
    "share": "OSC, LSL, opentrack",
}
STEP = 152  # between the middles of neighbouring columns
STAGE_PX, RING_PX = (128, 54), (108, 46)
LEFT = 110  # middle of the first column
SUPERVISOR, MIDDLE, DEMAND, BELOW, LIVE, HEIGHT = 118, 246, 342, 452, 552, 632  # rows; the figure
LIVE_STAGES = ("views", "disparity")  # of a live light field, in a row of their own
# rings with a random name, which exist while they are used: name -> writer
LEASED = {"packets": SOURCE, "pictures": SHOWN_BY}


def stages() -> tuple[Stage, ...]:
    """The stages of this repository, without those of installed packages."""
    return tuple(stage for stage in STAGES if stage.module.startswith("lfpipe."))


def shape(spec: RingSpec) -> str:
    """Of a slot."""
    return (
        " x ".join(str(size) for size in spec.shape)
        if spec.shape
        else f"{spec.dtype.itemsize} bytes"
    )


def columns(y: float) -> tuple[list[Box], list[Box]]:
    """(the core stages, the rings between them), in one row."""
    specs = rings(Config(), SessionOptions())
    core = [stage for stage in stages() if not stage.optional]
    boxes, between, x = [], [], float(LEFT)
    for stage in core:
        boxes.append(_stage(stage, x, y))
        for ring in stage.writes:
            if ring in specs:
                x += STEP
                lines = (ring, shape(specs[ring]))
                between.append(_ring(lines, x, y))
        x += STEP
    return boxes, between


def _stage(stage: Stage, x: float, y: float) -> Box:
    extra = stage.module.startswith("lfpipe.extras.")
    lines = (stage.name, WORK[stage.name])
    width, height = STAGE_PX
    fill = EXTRA if extra else CORE
    return Box(x=x, y=y, width=width, height=height, lines=lines, fill=fill, dashed=stage.optional)


def _ring(lines: Sequence[str], x: float, y: float, dashed: bool = False) -> Box:
    width, height = RING_PX
    return Box(
        x=x, y=y, width=width, height=height, lines=lines, fill=MEMORY, dashed=dashed, slots=True
    )


def _row(boxes: Sequence[Box]) -> list[str]:
    """The arrows between neighbours of a row."""
    ordered = sorted(boxes, key=lambda box: box.x)
    return [
        line([(a.right, a.y), (b.left, b.y)], width=2.5) for a, b in itertools.pairwise(ordered)
    ]


def _supervisor(core: Sequence[Box], y: float, lines: Sequence[str]) -> Box:
    left, right = core[0].left, core[-1].right
    return Box(x=(left + right) / 2, y=y, width=right - left, height=46, lines=lines)


def small() -> str:
    """The core in one row, and the supervisor above it."""
    core, between = columns(130)
    end = core[-1].x + STEP
    display = Box(
        x=end, y=130, width=96, height=54, lines=("display", "window, file"), fill=OUTSIDE
    )
    supervisor = _supervisor(
        core, 34, ("supervisor", "starts, restarts, configures; answers lfpipe ctl")
    )
    parts = [box.svg() for box in (supervisor, *core, *between, display)]
    parts += _row([*core, *between, display])
    for box in core:
        parts.append(line([(box.x, supervisor.bottom), (box.x, box.top)], both=True))
        parts.append(text((box.x + 6, 82), "control messages", anchor="start"))
    parts += [text((ring.x, ring.bottom + 16), "ring in shared memory") for ring in between]
    return figure(display.right + 46, 178, "The processes of a session", parts)


def large() -> str:
    """Every process, ring and socket."""
    core, between = columns(MIDDLE)
    by_name = {box.lines[0]: box for box in (*core, *between)}
    end = core[-1].x + STEP
    display = Box(
        x=end, y=MIDDLE, width=108, height=54, lines=("display", "window, file, none"), fill=OUTSIDE
    )
    supervisor = _supervisor(
        core, SUPERVISOR, ("supervisor", "process table, session state, restarts, quality levels")
    )
    clients = Box(
        x=by_name["track"].x - STEP,
        y=30,
        width=210,
        height=40,
        lines=("lfpipe ctl, import lfpipe",),
        fill=OUTSIDE,
    )
    monitors = Box(
        x=end - STEP / 2, y=30, width=180, height=40, lines=("lfpipe monitor, page",), fill=OUTSIDE
    )
    table = Box(
        x=end + 4,
        y=SUPERVISOR,
        width=128,
        height=46,
        lines=("status table", "one row per stage"),
        fill=MEMORY,
    )
    parts = [box.svg() for box in (supervisor, clients, monitors, table, *core, *between, display)]
    parts += _row([*core, *between, display])
    # clients and monitors
    parts.append(line([(clients.x, clients.bottom), (clients.x, supervisor.top)], both=True))
    parts.append(text((clients.x + 6, 76), "ctl: requests, answers", anchor="start"))
    x = monitors.left + 24
    parts.append(line([(x, supervisor.top), (x, monitors.bottom)]))
    parts.append(text((x - 6, 76), "tap: events", anchor="end"))
    x = table.left + 24
    parts.append(line([(x, table.top), (x, monitors.bottom)]))
    parts.append(text((x + 6, 76), "metrics", anchor="start"))
    # the supervisor and each core stage
    for box in core:
        ctl, bus = box.x - 16, box.x + 16
        parts += [
            line([(ctl, supervisor.bottom), (ctl, box.top)], both=True),
            line([(bus, box.top), (bus, supervisor.bottom)]),
            text((ctl - 6, 184), "ctl", anchor="end"),
            text((bus + 6, 184), "bus", anchor="start"),
        ]
    parts += [
        text((by_name["frames"].x, 178), "ctl: hello, config, stop"),
        text((by_name["frames"].x, 192), "bus: telemetry"),
        text((table.x, table.bottom + 16), "each stage writes its row"),
    ]
    parts += _on_demand(by_name, table.right + 20, monitors)
    parts += _optional(by_name, supervisor)
    parts += _live(by_name)
    legend = (
        (CORE, "process"),
        (EXTRA, "process of an extra"),
        (MEMORY, "shared memory"),
        (OUTSIDE, "outside the session"),
    )
    for i, (fill, words) in enumerate(legend):
        x = LEFT + 170 * i
        swatch = Box(x=x, y=HEIGHT - 16, width=16, height=12, lines=(), fill=fill)
        parts += [swatch.svg(), text((x + 14, HEIGHT - 12), words, anchor="start")]
    parts.append(text((LEFT + 170 * 4, HEIGHT - 12), "dashed: only on demand", anchor="start"))
    return figure(
        table.right + 34, HEIGHT, "Processes, rings and control messages of a session", parts
    )


def _on_demand(by_name: dict[str, Box], margin: float, monitors: Box) -> list[str]:
    """The rings that exist on demand, below their writers; that of pictures goes to the monitors.
    Adds them to by_name.
    """
    writers = {ring: stage.name for stage in stages() for ring in stage.writes if ring in ON_DEMAND}
    shapes = {ring: shape(ON_DEMAND[ring]) for ring in writers} | dict.fromkeys(LEASED, "on demand")
    parts = []
    count: dict[str, int] = {}
    for ring, writer in (writers | LEASED).items():
        above = by_name[writer]
        box = _ring(
            (ring, shapes[ring]), above.x + STEP * count.get(writer, 0), DEMAND, dashed=True
        )
        start = above.x + 32 * count.get(writer, 0)
        way = [(start, above.bottom), (start, 290.0), (box.x, 290.0), (box.x, box.top)]
        parts += [box.svg(), line(way, width=2.5)]
        by_name[ring] = box
        count[writer] = count.get(writer, 0) + 1
    pictures = by_name["pictures"]
    parts.append(
        line(
            [
                (pictures.right, DEMAND),
                (margin, DEMAND),
                (margin, monitors.y),
                (monitors.right, monitors.y),
            ],
            width=2.5,
        )
    )
    return parts


def _live(by_name: dict[str, Box]) -> list[str]:
    """The stages and rings of a live light field, and their way to render."""
    by_stage = {stage.name: stage for stage in stages()}
    row: list[Box] = []
    for name in LIVE_STAGES:
        stage = by_stage[name]
        row.append(_stage(stage, LEFT + STEP * len(row), LIVE))
        row.append(_ring((*stage.writes, "live scenes"), LEFT + STEP * len(row), LIVE, dashed=True))
    last, render = row[-1], by_name[SHOWN_BY]
    x = render.right + 12
    way = [(last.right, last.y), (x, last.y), (x, render.y + 14), (render.right, render.y + 14)]
    return [
        *(box.svg() for box in row),
        *_row(row),
        line(way, width=2.5),
        text((last.right + 12, last.y - 8), "views, disparity", anchor="start"),
        text((row[2].x, row[2].bottom + 16), "reads the viewpoints that render writes"),
    ]


def _optional(by_name: dict[str, Box], supervisor: Box) -> list[str]:
    """The optional stages, below the rings that they read, with their inputs and control."""
    optional = [stage for stage in stages() if stage.optional and stage.name not in LIVE_STAGES]
    reads = {
        stage.name: [
            *(ring for ring in stage.reads if ring in by_name),
            *(["packets"] if "frames" in stage.reads else []),
        ]
        for stage in optional
    }
    readers = {
        ring: [stage.name for stage in optional if ring in reads[stage.name]] for ring in by_name
    }
    parts = []
    bottom = BELOW + STAGE_PX[1] / 2 + 16
    lane = DEMAND + RING_PX[1] / 2
    margin = LEFT - STAGE_PX[0] / 2 - 20
    for stage in optional:
        sources = sorted((by_name[ring] for ring in reads[stage.name]), key=lambda box: box.x)
        # below the middle one, so that its arrow is straight
        middle = (
            sources[len(sources) // 2].x
            if len(sources) % 2
            else sum(source.x for source in sources) / len(sources)
        )
        box = _stage(stage, middle, BELOW)
        parts.append(box.svg())
        for i, source in enumerate(sources):
            names = readers[source.lines[0]]
            start = source.x + 24 * (names.index(stage.name) - (len(names) - 1) / 2)
            port = box.x + 36 * (i - (len(sources) - 1) / 2)
            y = lane + 14 + 12 * (i if source.x < box.x else len(sources) - 1 - i)
            points = [(start, source.bottom), (start, y), (port, y), (port, box.top)]
            parts.append(line(points, width=2.5))
        parts.append(
            line(
                [
                    (supervisor.left, supervisor.y),
                    (margin, supervisor.y),
                    (margin, bottom),
                    (box.x, bottom),
                    (box.x, box.bottom),
                ]
            )
        )
    parts.append(text((margin + 8, bottom - 6), "ctl, bus", anchor="start"))
    return parts


FIGURES = {"pipeline.svg": large, "pipeline_small.svg": small}

if __name__ == "__main__":
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    for name, drawn in FIGURES.items():
        (DOCS / name).write_text(drawn())
