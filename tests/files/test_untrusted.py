"""Values from files: for any content, the result is a checked value or a UserError."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.files.safe_files import Fields, finite, json_fields, toml_table

JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4)
    ),
    max_leaves=20,
)
HOSTILE_JSON = [
    b"[" * 100_000,
    b'{"a":' * 100_000,
    b'{"a":' * 50 + b"1" + b"}" * 50,
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
    b"a = 0x" + b"f" * 40,
    b"\xff",
    b"a = 1\na = 2",
]


def test_hostile_json_and_toml_are_refused() -> None:
    for parse, data in [(json_fields, data) for data in HOSTILE_JSON] + [
        (toml_table, data) for data in HOSTILE_TOML
    ]:
        with pytest.raises(UserError, match=r"^m\.x: ") as refused:
            parse(data, "m.x", "copy it again")
        assert refused.value.remedy == "copy it again" and len(str(refused.value)) < 300


# a reader, and the values it gives
READERS: list[tuple[Callable[[Fields], object], Callable[[Any], bool]]] = [
    (
        lambda f: f.number("k", 0.5, 10),
        lambda v: isinstance(v, int | float) and not isinstance(v, bool) and 0.5 <= v <= 10,
    ),
    (
        lambda f: f.integer("k", 1, 10),
        lambda v: isinstance(v, int) and not isinstance(v, bool) and 1 <= v <= 10,
    ),
    (lambda f: f.flag("k"), lambda v: isinstance(v, bool)),
    (lambda f: f.text("k", 3), lambda v: isinstance(v, str) and len(v) <= 3),
    (
        lambda f: f.numbers("k", 2, 0.5, 10),
        lambda v: (
            isinstance(v, list)
            and len(v) == 2
            and all(isinstance(n, int | float) and not isinstance(n, bool) for n in v)
            and all(0.5 <= n <= 10 for n in v)
        ),
    ),
    (lambda f: f.table("k").values, lambda v: isinstance(v, dict)),
]


@given(JSON_VALUES)
def test_a_field_has_its_type_and_range_or_is_refused(value: Any) -> None:
    for read, fits in READERS:
        try:
            result = read(Fields({"k": value}, "m.json", "remedy"))
        except UserError as error:
            assert "m.json: k " in error.message
            assert not fits(value)
        else:
            assert fits(value) and result == value
    with pytest.raises(UserError, match=r"m\.json: a: rows is missing"):
        json_fields(b'{"a": {}}', "m.json", "remedy").table("a").integer("rows", 1, 2)


def test_numbers_that_a_file_may_leave_out() -> None:
    values = {
        "3": 3.0,
        " 2.5 ": 2.5,
        "1e400": None,
        "nan": None,
        "11": None,
        "x": None,
        "-inf": None,
    }
    assert {text: finite(text, 0, 10) for text in values} == values
