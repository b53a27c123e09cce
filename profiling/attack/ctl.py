"""Hostile messages to one live session: ctl, bus and tap, raw connections, idle ones, and scenes to load."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfpipe.transport import control
from profiling.attack import raw
from profiling.attack.book import Book
from profiling.attack.case import Outcome, rng_of
from profiling.attack.live import Dead, Live
from profiling.attack.messages import Message, bus_message, ctl_message, tap_message

BATCH = 40
MOST_RESTARTS = 40
HARMLESS = ("hello", "status", "pause", "resume", "recentre", "pictures")
LOOK_S = 2.0  # how often pictures and processes are looked at
PARTS: dict[str, tuple[Callable[..., Message], float]] = {
    "ctl": (ctl_message, 0.85),
    "bus": (bus_message, 0.12),
    "tap": (tap_message, 0.03),
}


def _field(message: Message, field: str) -> Any:
    """A field of a message, where it can be read."""
    try:
        return control.decode(message.frames[0]).get(field)
    except control.BadMessage:
        return None


class TooMany(Exception):
    """So many sessions have ended that nothing more is to be learnt."""


class Campaign:
    """Sends batches, compares what the session says of itself before and after, and starts another where one ends."""

    def __init__(self, book: Book, work: Path) -> None:
        self.book, self.work = book, work
        self.live = Live(work)
        self._looked, self._seen = 0.0, self.live.state()
        self._said, self._first, self._restarts = 0, self.live.resources(), 0

    def fail(
        self, kind: str, outcome: str, group: str, detail: str, messages: list[tuple[int, Message]], name: str = "ctl"
    ) -> None:
        """Notes a failure with the messages that led to it."""
        found = Outcome(kind, outcome, group, detail)
        repeat = ""
        if self.book.wants(found):
            number = messages[0][0] if messages else len(self.book.causes)
            target = self.book.failures / f"{name}-{number}-{outcome}"
            target.mkdir(parents=True, exist_ok=True)
            (target / "messages.json").write_text(
                json.dumps([[number, [part.hex() for part in message.frames]] for number, message in messages])
            )
            (target / "REPEAT.txt").write_text(
                f"{outcome}: {group}\n{detail}\n\nmessages.json: to {name}, in this order\n", errors="backslashreplace"
            )
            repeat = str(target)
        self.book.add("ctl", found, messages[0][0] if messages else -1, repeat)

    def restart(self) -> None:
        """A new session in place of one that has ended. Raises TooMany where too many have."""
        self.live.end()
        self._restarts += 1
        if self._restarts > MOST_RESTARTS:
            raise TooMany
        self.live = Live(self.work)
        self._looked, self._seen, self._said, self._first = 0.0, self.live.state(), 0, self.live.resources()

    def batch(self, name: str, messages: list[tuple[int, Message]]) -> None:
        """Sends messages and judges what came of them; one by one where the session does not survive them."""
        try:
            self._batch(name, messages)
            if time.monotonic() - self._looked > LOOK_S:
                self.look(messages, name)
        except (Dead, control.BadMessage) as error:
            self.restart()
            if len(messages) > 1:
                half = len(messages) // 2
                before = self.book.total("ended")
                self.batch(name, messages[:half])
                self.batch(name, messages[half:])
                if self.book.total("ended") == before:
                    self.fail(f"{name}: together", "ended", str(error)[:60], str(error), messages, name)
            else:
                self.fail(
                    f"{name}: {messages[0][1].kind}",
                    "ended",
                    f"{name}: {messages[0][1].kind}: {str(error).splitlines()[-1][-80:]}",
                    str(error),
                    messages,
                    name,
                )

    def _batch(self, name: str, messages: list[tuple[int, Message]]) -> None:
        live = self.live
        before = live.told
        for _, message in messages:
            live.send(name, message)
        found = live.answers(sum(message.answered for _, message in messages))
        if name != "ctl":
            time.sleep(0.1)  # nothing says when these were taken: 40 are in two slices of the session's time
        told = live.hello()
        live.told = told
        accepted = [
            answer for data in found if (answer := self._judged(data, messages, name)) is not None and answer.get("ok") is True
        ]
        if len(found) != sum(message.answered for _, message in messages):
            self.fail(
                f"{name}: unanswered",
                "hang",
                f"{name}: messages without an answer",
                f"{len(found)} of {len(messages)}",
                messages,
                name,
            )
        changes = [answer for answer in accepted if "set" in answer]
        others = len(accepted) - len(changes)
        for _, message in messages:
            kind = f"{name}: {message.kind}"
            sets = _field(message, "set") if name == "ctl" else None
            taken = [answer for answer in changes if answer["set"] == sets]
            harmless = name == "ctl" and _field(message, "cmd") in HARMLESS and others > 0
            others -= harmless
            self.book.add("ctl", Outcome(kind, "accepted" if taken or harmless else "refused"))
            if not taken:
                continue
            hostile = [key for key, content in sets.items() if "." not in key or isinstance(content, list | dict | None)]
            if hostile:
                self.fail(
                    kind,
                    "half-applied",
                    f"took a set of {type(sets[hostile[0]]).__name__} for a key without a dot",
                    str(sets)[:500],
                    messages,
                    name,
                )
            for key, content in sets.items():
                section, _, last = key.partition(".")
                before["config"].get(section, {})[last] = content
        wrong = [key for key in before["config"] if before["config"][key] != told["config"].get(key)]
        if wrong:
            self.fail(
                f"{name}: set",
                "half-applied",
                f"configuration changed: {wrong[0]}",
                f"{before['config'][wrong[0]]} {told['config'].get(wrong[0])}",
                messages,
                name,
            )
        if before["options"] != told["options"]:
            self.fail(
                f"{name}: options", "half-applied", "options changed", f"{before['options']} {told['options']}", messages, name
            )
        quiet = not accepted and before["all"] == told["all"] and before["paused"] == told["paused"]
        if quiet and before["rev"] != told["rev"]:
            self.fail(
                f"{name}: revision",
                "half-applied",
                "the revision rose though nothing was taken",
                f"{before['rev']} {told['rev']}",
                messages,
                name,
            )

    def _judged(self, data: bytes, messages: list[tuple[int, Message]], name: str) -> dict[str, Any] | None:
        """The answer in data; None, and a failure, where it is none."""
        if len(data) > control.MAX_BYTES:
            self.fail(f"{name}: answer", "answer", "an answer above 64 KiB", f"{len(data)} bytes", messages, name)
            return None
        try:
            answer = control.decode(data)
        except control.BadMessage as error:
            self.fail(f"{name}: answer", "answer", "an answer that is no message", str(error), messages, name)
            return None
        if answer.get("ok") is not True and not (
            answer.get("ok") is False and isinstance(answer.get("error"), str) and answer["error"]
        ):
            self.fail(f"{name}: answer", "answer", "neither ok nor an error", str(answer)[:500], messages, name)
        if answer.get("ok") is False and "internal" in str(answer.get("error")):
            self.fail(
                f"{name}: answer", "traceback", f"internal error: {str(answer['error'])[:120]}", str(answer)[:500], messages, name
            )
        return answer

    def look(self, messages: list[tuple[int, Message]], name: str) -> None:
        """Whether pictures advance, no stage was restarted, and nothing with a stack was printed."""
        if self.live.hello()["paused"]:
            self.live.ask({"cmd": "resume"})
            self.live.told = self.live.hello()
        end = time.monotonic() + 20
        while True:
            now = self.live.state()
            if now["render"]["count"] > self._seen["render"]["count"]:
                break
            if time.monotonic() > end:
                self.fail(f"{name}: pictures", "hang", "no new picture for 20 s", str(now)[:1500], messages, name)
                break
            time.sleep(0.1)
        again = [stage for stage in now if now[stage]["restarts"] != self._seen.get(stage, {"restarts": 0})["restarts"]]
        if again:
            self.fail(f"{name}: stage", "ended", f"{again[0]} was started again", self.live.said()[-1500:], messages, name)
        said = self.live.said()
        if "Traceback" in said[self._said :]:
            self.fail(f"{name}: log", "traceback", said.strip().splitlines()[-1][:120], said[-3000:], messages, name)
        self._said, self._seen, self._looked = len(said), now, time.monotonic()

    def figures(self) -> None:
        """How much the supervisor grew."""
        memory, files = self.live.resources()
        self.book.notes.append(
            f"supervisor after it, memory and open files: {self._first[0]:.0f} -> {memory:.0f} MB, {self._first[1]} -> {files}"
        )


def _settled(campaign: Campaign, name: str) -> None:
    """A last look after all messages of a kind."""
    try:
        campaign.look([], name)
    except (Dead, control.BadMessage) as error:
        campaign.fail(f"{name}: all", "ended", f"{name}: the session ended after the last batch", str(error), [], name)
        campaign.restart()


def run(book: Book, count: int, work: Path) -> None:
    """count messages over all ways, then scenes to load."""
    campaign = Campaign(book, work)
    try:
        for name, (make, share) in PARTS.items():
            numbers = range(int(count * share))
            for start in range(0, len(numbers), BATCH):
                campaign.batch(name, [(n, make(rng_of(book.seed, name, n))) for n in numbers[start : start + BATCH]])
            _settled(campaign, name)
        raw.garbage(campaign, max(30, count // 300))
        raw.crowd(campaign, 1200)
        campaign.figures()
        raw.loads(campaign, max(6, min(40, count // 1500)))
    except TooMany:
        book.notes.append(f"ctl: given up after {MOST_RESTARTS} sessions that ended")
    finally:
        campaign.live.end()
