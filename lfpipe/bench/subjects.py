"""The subjects by their names, in the order of a report."""

from __future__ import annotations

from lfpipe.bench import anaglyph, filters, pipeline, plan, stability, storage, synthesis, tracker
from lfpipe.bench.model import Subject

SUBJECTS: dict[str, Subject] = {
    module.SUBJECT.name: module.SUBJECT for module in (tracker, filters, synthesis, anaglyph, storage, pipeline, stability, plan)
}
