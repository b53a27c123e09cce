"""One build under comparison: answers requests on stdin, one JSON object a line, with figures on stdout.

    {"prepare": SUBJECT, "candidates": [NAME, ...] or null}  ->  {"names": [...], "failed": {name: why}}
    {"errors": NAME} -> {figure: [sample, ...]}        {"turn": NAME} -> {figure: sample}

It runs with its own checkout first on the path; which inputs, it is told in its argument.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import cv2

from lfpipe.bench.inputs import make_inputs
from lfpipe.bench.model import Candidate, Prepared
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.config import Config, updated


def main() -> None:
    """Serves until stdin ends. Arguments: the folder to keep packs in; a scene and a sequence, or neither for the demo's."""
    cv2.setNumThreads(1)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    settings = updated(Config(), {"scene.cache_dir": sys.argv[1]})
    given = [Path(text) for text in sys.argv[2:]]
    inputs = make_inputs(tuple(given[:1]), given[1] if given else None, True, settings, lambda *_: None)
    ready: dict[str, Prepared] = {}
    for line in sys.stdin:
        request: dict[str, Any] = json.loads(line)
        answer: dict[str, Any]
        if "prepare" in request:
            failed: dict[str, str] = {}
            offered = SUBJECTS[request["prepare"]].candidates
            for one in offered(inputs) if offered else ():
                if isinstance(one, Candidate) and (request["candidates"] is None or one.name in request["candidates"]):
                    try:
                        ready[one.name] = one.prepare()
                    except Exception as error:  # told, and the others go on
                        failed[one.name] = f"{type(error).__name__}: {error}"
            answer = {"names": list(ready), "failed": failed}
        else:
            try:
                answer = _answer(request, ready)
            except Exception as error:  # as above
                answer = {"failed": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _answer(request: dict[str, Any], ready: dict[str, Prepared]) -> dict[str, Any]:
    if "errors" in request:
        return dict(ready[request["errors"]].errors())
    turn = ready[request["turn"]].turn
    return dict(turn()) if turn is not None else {}


if __name__ == "__main__":
    main()
