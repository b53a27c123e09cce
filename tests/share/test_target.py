"""Targets on the command line: accepted, or refused by name before anything starts, without sending anything."""

import socket
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.cli.launch import UpArguments, prepare
from lfpipe.errors import UserError
from lfpipe.share import target as module
from lfpipe.share.target import check_liblsl, check_target, check_targets, parse_target


@pytest.mark.parametrize(
    ("text", "exact"),
    [
        ("opentrack:127.0.0.1:4242", "opentrack:127.0.0.1:4242"),
        ("opentrack:localhost:4242?rate=120", "opentrack:127.0.0.1:4242?rate=120"),
        ("osc:[::1]:9000", "osc:[::1]:9000"),
        ("lsl", "lsl:lfpipe"),
        ("lsl:eye lab?rate=59.94", "lsl:eye lab?rate=59.94"),
    ],
)
def test_what_is_taken_has_one_exact_form(text: str, exact: str) -> None:
    assert str(check_target(text)) == exact
    assert str(parse_target(exact)) == exact


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "unknown kind"),
        ("opentrak:127.0.0.1:4242", "did you mean 'opentrack'"),
        ("opentrack", "no HOST:PORT"),
        ("opentrack:127.0.0.1", "no HOST:PORT"),
        ("opentrack::4242", "no HOST:PORT"),
        ("osc:127.0.0.1:0", "not a port"),
        ("osc:127.0.0.1:65536", "not a port"),
        ("osc:127.0.0.1:http", "not a port"),
        ("osc:127.0.0.1:²", "not a port"),
        ("osc:0.0.0.0:9000", "no address to send to"),
        ("osc:[::]:9000", "no address to send to"),
        ("osc:no such host.invalid:9000", "no such host"),
        ("osc:a\0b:9000", "a\\x00b"),
        (f"osc:{'x' * 300}:9000", "not a host name"),
        ("osc:255.255.255.255:9000", "Permission denied"),
        ("osc:127.0.0.1:9000?rate=0", "rate=HZ"),
        ("osc:127.0.0.1:9000?rate=nan", "rate=HZ"),
        ("osc:127.0.0.1:9000?rate=1001", "rate=HZ"),
        ("osc:127.0.0.1:9000?speed=60", "rate=HZ"),
        ("lsl:", "1 to 64 characters"),
        ("lsl:a\nb", "1 to 64 characters"),
    ],
)
def test_what_cannot_work_is_refused_by_name(text: str, why: str) -> None:
    with pytest.raises(UserError) as caught:
        check_target(text)
    assert why in str(caught.value) and "--share" in caught.value.message and caught.value.remedy


@given(st.text(max_size=40) | st.from_regex(r"(osc|opentrack|lsl):.{0,20}:?[0-9]{0,7}(\?rate=.{0,6})?", fullmatch=True))
def test_any_text_is_taken_in_its_exact_form_or_refused(text: str) -> None:
    try:
        target = parse_target(text)
    except UserError as error:
        assert error.remedy
    else:
        assert parse_target(str(target)) == target


def test_no_target_twice_and_not_too_many() -> None:
    with pytest.raises(UserError, match="already"):
        check_targets(["lsl", "lsl:lfpipe?rate=60"])
    with pytest.raises(UserError, match="already"):
        check_targets(["osc:localhost:9000"], running=("osc:127.0.0.1:9000",))
    with pytest.raises(UserError, match="9 targets, 8 at most"):
        check_targets([f"osc:127.0.0.1:{9000 + k}" for k in range(9)])


@pytest.mark.parametrize(("text", "library"), [("osc:127.0.0.1:9000", "pythonosc"), ("lsl", "pylsl")])
def test_a_missing_library_is_named_with_its_extra(text: str, library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    find = module.importlib.util.find_spec
    monkeypatch.setattr(module.importlib.util, "find_spec", lambda name: None if name == library else find(name))
    with pytest.raises(UserError, match="not installed") as caught:
        check_target(text)
    assert "lfpipe[share]" in caught.value.remedy


def test_a_pylsl_without_its_library_is_told_where_that_is_to_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(UserError, match="does not find its library") as caught:
        check_liblsl()
    assert "PYLSL_LIB" in caught.value.remedy


def test_a_check_sends_nothing() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(0.2)
        check_target(f"opentrack:127.0.0.1:{receiver.getsockname()[1]}")
        with pytest.raises(TimeoutError):
            receiver.recv(64)


def test_no_picture_goes_with_nothing_that_shows_one() -> None:
    for more in ({"display": "none"}, {"trace": Path("t.jsonl")}, {"scenes": (Path(),)}):
        with pytest.raises(UserError, match="--no-picture"):
            prepare(UpArguments(**{"camera": "demo", "no_picture": True} | more))
