"""Competing interpretations of a scene, each with one score. The best one is used;
`lfpipe scene info -v` prints the others, too.
"""

import logging
from collections.abc import Mapping, Sequence
from typing import Generic, TypeVar

import attrs

log = logging.getLogger(__name__)
T = TypeVar("T")


@attrs.frozen(kw_only=True)
class Candidate(Generic[T]):
    """One interpretation."""

    what: str  # for people
    score: float  # higher is likelier; comparable within one question
    value: T
    measures: Mapping[str, float] = attrs.field(factory=dict)  # the parts of the score, by name


def ranked(question: str, candidates: Sequence[Candidate[T]]) -> list[Candidate[T]]:
    """The candidates by falling score, in a stable order; logs them as a table."""
    order = sorted(candidates, key=lambda candidate: -candidate.score)
    if order:
        rows = [
            f"  {candidate.score:8.3f}  {candidate.what}"
            + "".join(f", {name} {value:.3g}" for name, value in candidate.measures.items())
            for candidate in order[:6]
        ]
        log.info("%s, best of %d first:\n%s", question, len(order), "\n".join(rows))
    return order
