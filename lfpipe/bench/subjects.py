"""The subjects by name, in the order of the report."""

from lfpipe.bench import anaglyph, filters, judder, photon, pipeline, plan, stability, synthesis, tracker
from lfpipe.bench.model import Subject

SUBJECTS: dict[str, Subject] = {
    module.SUBJECT.name: module.SUBJECT
    for module in (tracker, filters, photon, judder, synthesis, anaglyph, pipeline, stability, plan)
}
