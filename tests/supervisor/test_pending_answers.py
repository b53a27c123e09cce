"""`PendingAnswers`: recipients and times of answers, without a socket or a clock."""

from lfpipe.supervisor.control_sockets import (
    APPLY_NS,
    EXECUTE_NS,
    START_NS,
    PendingAnswers,
    Request,
)
from lfpipe.supervisor.requests import Reply
from tests.supervisor.states import made_state

OK = {"ok": True}
FIRST, SECOND, THIRD = Request(b"first"), Request(b"second"), Request(b"third")


def answers(pending: PendingAnswers, applied_rev: int, t_ns: int) -> list[tuple[bytes, object]]:
    due = pending.due(lambda rev: rev <= applied_rev, t_ns)
    return [(request.client, answer.get("applied", answer["ok"])) for request, answer, _ in due]


def test_pending_answers_await_a_revision() -> None:
    pending = PendingAnswers()
    pending.add(FIRST, Reply(), OK, 2, False, 0)
    pending.add(SECOND, Reply(), OK, 3, False, 10)
    assert answers(pending, 1, APPLY_NS) == [] and pending
    assert answers(pending, 2, APPLY_NS) == [(b"first", True)]
    assert answers(pending, 2, APPLY_NS + 11) == [(b"second", False)] and not pending


def test_pending_answers_refuse_only_what_is_undone() -> None:
    pending = PendingAnswers()
    pending.add(FIRST, Reply(), OK, 4, True, 0)
    pending.add(SECOND, Reply(), OK, 5, False, 0)
    pending.add(THIRD, Reply(executed_by=("render",)), OK, 1, False, 0)
    refused = {"ok": False, "error": "why"}
    assert list(pending.refuse_changes({"error": "why"})) == [(FIRST, refused)]
    assert answers(pending, 6, 1) == [(b"second", True)] and pending


def test_pending_answers_await_all_stages() -> None:
    pending = PendingAnswers()
    number = pending.add(FIRST, Reply(executed_by=("render", "track")), OK, 1, False, 0)
    message = {"v": 2, "cmd": "executed", "number": number, "ok": True, "path": "/x"}
    pending.executed("render", message)
    pending.executed("share", message)
    pending.executed("track", {**message, "number": number + 1})
    assert answers(pending, 0, EXECUTE_NS) == []
    pending.executed("track", {"v": 2, "cmd": "executed", "number": number, "ok": True})
    assert (
        list(pending.due(bool, 1))
        == [(FIRST, {"ok": True, "stages": {"render": {"path": "/x"}}}, None)]
        and not pending
    )


def test_pending_answers_name_a_stage_that_fails_or_is_silent() -> None:
    pending = PendingAnswers()
    number = pending.add(FIRST, Reply(executed_by=("render", "track")), OK, 1, False, 0)
    pending.executed("render", {"number": number, "ok": False, "error": "no room"})
    pending.executed("track", {"number": number, "ok": True})
    assert list(pending.due(bool, 1)) == [(FIRST, {"ok": False, "error": "no room"}, None)]
    pending.add(SECOND, Reply(executed_by=("render",)), OK, 1, False, 0)
    ((_, answer, _),) = pending.due(bool, EXECUTE_NS + 1)
    assert answer["ok"] is False and answer["error"].startswith("render did not execute it")


def test_a_stage_that_starts_for_a_request_answers_it_by_its_number() -> None:
    pending = PendingAnswers()
    reply = Reply(executed_by=("capture",), state=made_state(), then=lambda *_: Reply())
    first = pending.add(FIRST, reply, OK, 1, False, 0)
    pending.add(SECOND, Reply(executed_by=("capture",)), OK, 1, False, 0)  # by a message
    assert (pending.number_for("capture"), pending.number_for("track")) == (first, 0)
    assert [request for request, _, _ in pending.due(bool, EXECUTE_NS + 1)] == [SECOND]
    pending.executed("capture", {"number": first, "ok": True, "source": "demo"})
    answer = {"ok": True, "stages": {"capture": {"source": "demo"}}}
    assert list(pending.due(bool, START_NS)) == [(FIRST, answer, reply.then)]
    first = pending.add(FIRST, reply, OK, 1, False, 0)
    pending.executed("capture", {"number": first, "ok": False, "error": "no room"})
    assert list(pending.due(bool, 1)) == [(FIRST, {"ok": False, "error": "no room"}, None)]
