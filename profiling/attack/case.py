"""One hostile input for the command line: the files it needs, the command, and what counts as held."""

import json
import os
import random
import re
from pathlib import Path
from typing import Any

import attrs

MOST_MB = 300.0  # of a refusal
MOST_OUTPUT = 1 << 16  # bytes of a refusal's text
HELD = ("refused", "accepted")
MEMORY = "memory"
FAILURES = ("ended", "traceback", "hang", "half-applied", MEMORY, "answer")


@attrs.frozen
class Case:
    """argv: after `lfpipe`, with paths relative to the case's folder, which is the current directory.

    kind: what was tried, in a few words. outputs: what a refusal must not leave. codes: exit codes that are right.
    unprivileged: without root's right to read everything.
    """

    kind: str
    argv: list[str]
    outputs: tuple[str, ...] = ("out", "cache/scenes/*")
    codes: tuple[int, ...] = (0, 2)
    unprivileged: bool = False
    env: dict[str, str] = attrs.field(factory=dict)


@attrs.frozen
class Outcome:
    """outcome: refused, accepted, or one of FAILURES. group: what failures of one cause have in common."""

    kind: str
    outcome: str
    group: str = ""
    detail: str = ""
    peak_mb: float = 0.0
    argv: tuple[str, ...] = ()
    seconds: float = 0.0


def rng_of(seed: int, part: str, number: int) -> random.Random:
    """The randomness of one input: the same for the same three."""
    return random.Random(f"{seed}:{part}:{number}")


def _strict(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


def judged(case: Case, folder: Path, code: int, out: str, err: str, peak_mb: float) -> Outcome:
    """Whether a command's end is as it must be. code: its exit code, negative for a signal. peak_mb: 0 for unknown."""

    def failed(outcome: str, group: str, detail: str) -> Outcome:
        return Outcome(case.kind, outcome, group, detail[-3000:], peak_mb, tuple(case.argv))

    if "Traceback (most recent call last)" in err:
        last = err.strip().splitlines()[-1][:200]
        places = re.findall(r'File "[^"]*/(lfpipe/[^"]+)", line (\d+)', err)
        place = ":".join(places[-1]) if places else "?"
        return failed("traceback", f"{last.split(':')[0]} at {place}", f"{last}\n{err}")
    if code < 0 or code not in case.codes:
        return failed("traceback", f"exit code {code}", err)
    if code == 2:
        if not err.strip() or not ("error:" in err or "Usage:" in err or "Error:" in err):
            return failed("answer", "a refusal without words", err)
        if len(err.encode(errors="replace")) > MOST_OUTPUT:
            return failed("answer", f"a refusal of {len(err) >> 10} KiB", err)
        left = [str(path.relative_to(folder)) for name in case.outputs for path in folder.glob(name)]
        if left:
            return failed("half-applied", f"left by {' '.join(case.argv[:2])}: {Path(left[0]).parts[0]}", f"{left}\n{err}")
        if peak_mb > MOST_MB:
            return failed(
                MEMORY, f"a refusal over {MOST_MB:g} MB: {re.sub(r'[0-9]+', 'N', err.strip()[-60:])}", f"{peak_mb:.0f} MB\n{err}"
            )
        return Outcome(case.kind, "refused", "", err.strip()[:200], peak_mb)
    if "--json" in case.argv and code == 0 and "--help" not in case.argv:
        try:
            json.loads(out, parse_constant=_strict)
        except ValueError as error:
            return failed("answer", f"--json of {' '.join(case.argv[:2])} is not JSON", f"{error}\n{out[:500]}")
    return Outcome(case.kind, "accepted", "", "", peak_mb)


def give_away(folder: Path, uid: int) -> None:
    """Makes folder and all in it belong to another user, modes as they are; links are not followed."""
    for base, folders, files in os.walk(os.fsencode(folder)):
        for name in (b".", *folders, *files):
            os.chown(os.path.join(base, name), uid, uid, follow_symlinks=False)  # noqa: PTH118
