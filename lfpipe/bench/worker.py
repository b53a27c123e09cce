"""One build under comparison: answers requests on stdin, one JSON object a line, with figures on stdout.

    {"prepare": SUBJECT, "curves": [CURVE, ...] or null}  ->  {"names": [...], "failed": {name: why}}
    {"errors": NAME} -> {figure: [sample, ...]}        {"turn": NAME} -> {figure: sample}

With `curves` the first candidate of each. Errors and turns are measured in a child process forked for the request. How fast code
runs depends by some percent on where its memory happens to lie, for as long as a process lives: a child prepares the candidate
anew, in pages of its own, so that two turns are two draws and the luck of one process does not look like a difference of builds.

It runs with its own checkout first on the path; which inputs, it is told in its arguments.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lfpipe.bench.inputs import make_inputs
from lfpipe.bench.model import Candidate
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.config import Config, updated

TURN_S, MOST_TURNS = 0.008, 10  # a turn that is shorter is repeated
PADS, PAD_BYTES = 8, 60_000  # of memory taken before a candidate's own, so that this begins somewhere else every time

Answer = dict[str, Any]


def main() -> None:
    """Serves until stdin ends. Arguments: the folder to keep packs in; a scene and a sequence, or neither for the demo's."""
    cv2.setNumThreads(1)
    gc.disable()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    settings = updated(Config(), {"scene.cache_dir": sys.argv[1]})
    given = [Path(text) for text in sys.argv[2:]]
    inputs = make_inputs(tuple(given[:1]), given[1] if given else None, True, settings, lambda *_: None)
    ready: dict[str, Candidate] = {}
    for line in sys.stdin:
        request: Answer = json.loads(line)
        if "prepare" in request:
            failed: dict[str, str] = {}
            offered = SUBJECTS[request["prepare"]].candidates
            found = [one for one in (offered(inputs) if offered else ()) if isinstance(one, Candidate)]
            for one in chosen(found, request["curves"]):
                try:
                    one.prepare().close()  # what candidates share is made once, here
                    ready[one.name] = one
                except Exception as error:  # told, and the others go on
                    failed[one.name] = f"{type(error).__name__}: {error}"
            answer: Answer = {"names": list(ready), "failed": failed}
        else:
            answer = forked(lambda r=request: _answer(r, ready))  # type: ignore[misc]
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def chosen(found: list[Candidate], curves: list[str] | None) -> list[Candidate]:
    """The first candidate of each curve; all of them without curves."""
    if curves is None:
        return found
    firsts = {one.curve: one for one in reversed(found)}
    return [firsts[curve] for curve in curves if curve in firsts]


def forked(work: Callable[[], Answer]) -> Answer:
    """What work returns in a child process; {"failed": why} where it throws or the child ends."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            answer = work()
        except BaseException as error:  # nothing of the parent may run on in the child
            answer = {"failed": f"{type(error).__name__}: {error}"}
        with os.fdopen(writing, "w") as pipe:
            json.dump(answer, pipe)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        text = pipe.read()
    _, status = os.waitpid(pid, 0)
    told: Answer = json.loads(text) if text else {"failed": f"ended with {os.waitstatus_to_exitcode(status)}"}
    return told


def _answer(request: Answer, ready: dict[str, Candidate]) -> Answer:
    if "errors" in request:
        return dict(ready[request["errors"]].prepare().errors())
    rng = np.random.default_rng(os.getpid())
    pads = [np.empty(int(size), np.uint8) for size in rng.integers(1, PAD_BYTES, PADS)]
    turn = ready[request["turn"]].prepare().turn
    if turn is None:
        return {}
    turn()  # warm-up
    told, start = [turn()], time.perf_counter()
    while time.perf_counter() - start < TURN_S and len(told) < MOST_TURNS:
        told.append(turn())
    del pads
    return {key: float(np.median([one[key] for one in told])) for key in told[0]}


if __name__ == "__main__":
    main()
