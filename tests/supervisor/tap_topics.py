"""The topics of the tap: the writers of each, and its fields besides `topic` and `t_ns`; messages
of stages also have `stage`. A test compares this table with the code and with docs/contracts.md.
"""

import attrs


@attrs.frozen
class Topic:
    """One topic."""

    name: str
    writers: tuple[str, ...]
    """Stages, "every stage", or "supervisor"."""
    fields: tuple[str, ...]
    meaning: str


SUPERVISOR = ("supervisor",)
CAPTURES = ("capture", "views")
TOPICS = (
    Topic(
        "source", ("capture", "views"), ("name", "rate_hz", "live", "notes"), "a source was opened"
    ),
    Topic(
        "camera",
        ("capture", "views"),
        ("name", "lost", "why", "away_s"),
        "a camera is lost or back",
    ),
    Topic("engine", ("track",), ("name", "model"), "a face engine was opened"),
    Topic("face", ("track",), ("found", "source_seq"), "a face was found or lost"),
    Topic("alignment", ("disparity",), ("rotation_deg",), "of the right one of two live cameras"),
    Topic("viewer", ("render",), ("state",), "the viewer's presence has changed"),
    Topic("parallax", ("render",), ("text",), "the parallax has changed"),
    Topic(
        "look",
        ("render",),
        ("face", "eyes_px", "grid", "alpha_px", "centre_px"),
        "the eyes and the grid of views, while pictures are leased",
    ),
    Topic("notice", ("every stage",), ("text",), "for the user"),
    Topic("failed", SUPERVISOR, ("stage", "code", "phase", "source_seq"), "a stage has failed"),
    Topic("refused", SUPERVISOR, ("stage", "why"), "a change was rolled back"),
    Topic("level", SUPERVISOR, ("level", "lowest", "words", "stage", "why"), "another quality"),
)
