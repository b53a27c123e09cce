"""One of two builds in a comparison. Answers requests on stdin, one JSON object per line, with figures on stdout.

    {"prepare": SUBJECT, "curves": [CURVE, ...] or null}  ->  {"names": [...], "failed": {name: why}}
    {"errors": NAME} -> {figure: [sample, ...]}        {"turn": NAME} -> {figure: sample}

With `curves` only the first candidate of each is prepared. Errors and turns are measured in a child forked for the request, which
prepares the candidate again. The memory layout of a process changes its speed by some percent for its whole life. Children have
different layouts, so this becomes noise between turns and does not look like a difference between builds.

The worker runs with its own checkout first on the path. Builds of other versions must understand the requests.
"""

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

TURN_S, MAX_TURNS = 0.008, 10  # a shorter turn is repeated
PADS, PAD_BYTES = 8, 60_000  # of memory allocated before a candidate's own, to vary its layout

Answer = dict[str, Any]


def main() -> None:
    """Serves until stdin closes. Arguments: a folder for packs; a scene and a sequence, or neither for the demo's."""
    cv2.setNumThreads(1)
    gc.disable()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # output of libraries is not an answer
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
            for one in first_of_curves(found, request["curves"]):
                try:
                    one.prepare().close()  # shared work of candidates is done once, here
                    ready[one.name] = one
                except Exception as error:  # report it and continue with the others
                    failed[one.name] = f"{type(error).__name__}: {error}"
            answer: Answer = {"names": list(ready), "failed": failed}
        else:
            answer = in_child(lambda r=request: _answer(r, ready))  # type: ignore[misc]
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def first_of_curves(found: list[Candidate], curves: list[str] | None) -> list[Candidate]:
    """The first candidate of each curve; all candidates if curves is None."""
    if curves is None:
        return found
    firsts = {one.curve: one for one in reversed(found)}
    return [firsts[curve] for curve in curves if curve in firsts]


def in_child(work: Callable[[], Answer]) -> Answer:
    """The result of work in a forked child; {"failed": why} if it raises or the child dies."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            answer = work()
        except BaseException as error:  # the child must not continue as the parent
            answer = {"failed": f"{type(error).__name__}: {error}"}
        with os.fdopen(writing, "w") as pipe:
            json.dump(answer, pipe)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        text = pipe.read()
    _, status = os.waitpid(pid, 0)
    return dict(json.loads(text)) if text else {"failed": f"exited with {os.waitstatus_to_exitcode(status)}"}


def _answer(request: Answer, ready: dict[str, Candidate]) -> Answer:
    if "errors" in request:
        return dict(ready[request["errors"]].prepare().errors())
    rng = np.random.default_rng(os.getpid())
    pads = [np.empty(int(size), np.uint8) for size in rng.integers(1, PAD_BYTES, PADS)]
    turn = ready[request["turn"]].prepare().turn
    if turn is None:
        return {}
    turn()  # warm-up
    turns, start = [turn()], time.perf_counter()
    while time.perf_counter() - start < TURN_S and len(turns) < MAX_TURNS:
        turns.append(turn())
    del pads
    return {key: float(np.median([one[key] for one in turns])) for key in turns[0]}


if __name__ == "__main__":
    main()
