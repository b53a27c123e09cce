"""From file order to canonical order (row 0 top camera, column 0 left camera), with the evidence and how sure it is."""

from __future__ import annotations

import attrs

from lfpipe import config
from lfpipe.scene.source import Source, Turn


@attrs.frozen
class Orientation:
    """turn: from file order to canonical. by: "override", "coordinates", "layout", "truth", "flow" or "nothing"; sure: 0..1;
    said: one sentence a person can use."""

    turn: Turn
    by: str
    sure: float
    said: str


def orient(source: Source, scene: config.Scene) -> Orientation:
    """The way to canonical order: the user's word first, then what the layout or coordinates tell."""
    known = source.turn
    found = Orientation(known, "layout", 1.0, source.turn_by) if known else Orientation(Turn(), "nothing", 0.0, "")
    turn = found.turn
    if scene.flip != "auto":
        turn = attrs.evolve(turn, rows=scene.flip in ("rows", "both"), cols=scene.flip in ("cols", "both"))
    if scene.transpose != "auto":
        turn = attrs.evolve(turn, transpose=scene.transpose == "yes")
    if turn != found.turn:
        return Orientation(turn, "override", 1.0, "as told")
    return found
