"""Values from files: for any content, the result is a checked value or a UserError."""

import json
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.files.untrusted import MAX_INTEGER, Fields, finite, json_fields, parse_json, parse_toml

JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=20,
)
HOSTILE_JSON = [
    b"[" * 100_000,
    b'{"a":' * 100_000,
    b"[" * 50 + b"]" * 50,
    b"9" * 5000,
    b"-" + b"9" * 30,
    b"18446744073709551616",
    b"1e999",
    b"NaN",
    b"[-Infinity]",
    b'"\xff"',
    b'{"\\ud800": 1}',
    b'["\\udc00"]',
    b"",
    b"\x00",
    '{"a": 1}'.encode("utf-16"),
]
HOSTILE_TOML = [
    b"a = " + b"[" * 10_000,
    b"a = " + b"9" * 5000,
    b"a = 1e999",
    b"a = nan",
    b"a = 0x" + b"f" * 40,
    b"\xff",
    b"a = 1\na = 2",
]


@pytest.mark.parametrize("data", HOSTILE_JSON, ids=range(len(HOSTILE_JSON)))
def test_hostile_json_is_refused(data: bytes) -> None:
    with pytest.raises(UserError, match=r"^m\.json: ") as refused:
        parse_json(data, "m.json", "copy it again")
    assert refused.value.remedy == "copy it again" and len(str(refused.value)) < 300


@pytest.mark.parametrize("data", HOSTILE_TOML, ids=range(len(HOSTILE_TOML)))
def test_hostile_toml_is_refused(data: bytes) -> None:
    with pytest.raises(UserError, match=r"^c\.toml: "):
        parse_toml(data, "c.toml", "copy it again")


@given(JSON_VALUES)
def test_what_is_in_bounds_is_read_as_it_is(value: Any) -> None:
    try:
        read = parse_json(json.dumps(value), "m.json", "remedy")
    except UserError:
        assert not in_bounds(value)
    else:
        assert in_bounds(value) and read == value


def in_bounds(value: Any) -> bool:
    if isinstance(value, dict):
        return all(map(in_bounds, value)) and all(map(in_bounds, value.values()))
    if isinstance(value, list):
        return all(map(in_bounds, value))
    return not (isinstance(value, float) and not math.isfinite(value)) and not (
        isinstance(value, int) and not -MAX_INTEGER - 1 <= value <= MAX_INTEGER
    )


@given(st.binary(max_size=200))
def test_any_bytes(data: bytes) -> None:
    for parse in (parse_json, parse_toml, json_fields):
        try:
            parse(data, "file", "remedy")
        except UserError as error:
            assert error.message.startswith("file: ")


READERS: list[Callable[[Fields], object]] = [
    lambda fields: fields.number("k", 0.5, 10),
    lambda fields: fields.integer("k", 1, 10),
    lambda fields: fields.flag("k"),
    lambda fields: fields.text("k", 3),
    lambda fields: fields.items("k", 2),
    lambda fields: fields.table("k").values,
]


@given(JSON_VALUES)
def test_a_field_has_its_type_and_range_or_is_refused(value: Any) -> None:
    for reader, fits in zip(READERS, [is_number, is_integer, is_flag, is_text, is_items, is_table], strict=True):
        try:
            read = reader(Fields({"k": value}, "m.json", "remedy"))
        except UserError as error:
            assert "m.json: k " in error.message
            assert not fits(value)
        else:
            assert fits(value) and read == value


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.5 <= value <= 10


def is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= 10


def is_flag(value: Any) -> bool:
    return isinstance(value, bool)


def is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= 3


def is_items(value: Any) -> bool:
    return isinstance(value, list) and len(value) <= 2


def is_table(value: Any) -> bool:
    return isinstance(value, dict)


def test_a_missing_field_is_named() -> None:
    with pytest.raises(UserError, match=r"m\.json: a: rows is missing"):
        json_fields(b'{"a": {}}', "m.json", "remedy").table("a").integer("rows", 1, 2)


@pytest.mark.parametrize(
    ("text", "value"), [("3", 3.0), (" 2.5 ", 2.5), ("1e400", None), ("nan", None), ("11", None), ("x", None), ("-inf", None)]
)
def test_numbers_that_a_file_may_leave_out(text: str, value: float | None) -> None:
    assert finite(text, 0, 10) == value
