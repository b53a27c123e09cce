"""A whole run: subjects one after the other into a folder, gone on with where it was broken off."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Results, SubjectResults, about, read
from lfpipe.bench.runner import run
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.errors import UserError

Say = Callable[[str, int, int], None]


def measure(names: Sequence[str], inputs: Inputs, out: Path, say: Say) -> Results:
    """Measures the named subjects and writes out/results.json on the way. Returns everything in it.

    Results of the same inputs, versions and source that lie in out already are kept: a run broken off goes on, another subject is
    added. Others are replaced. Raises UserError where out cannot be written.
    """
    cv2.setNumThreads(1)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{out}: {error.strerror}", "name another folder with --out DIR") from None
    results = Results(about(inputs))
    if (out / "results.json").is_file():
        try:
            before = read(out)
        except UserError:
            before = None
        if before is not None and before.about.get("identity") == results.about["identity"]:
            results.subjects = before.subjects
    for name in names:
        found = results.subjects.setdefault(name, SubjectResults(name))
        if not found.done:
            run(SUBJECTS[name], inputs, found, say, lambda: results.write(out))
    results.subjects = {name: results.subjects[name] for name in SUBJECTS if name in results.subjects}
    results.write(out)
    return results
