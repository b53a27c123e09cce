"""Messages: whatever they quote, they are short, of one encoding, and never an exception
themselves.
"""

from hypothesis import given
from hypothesis import strategies as st

from lfpipe.errors import UserError, quoted
from tests.support.hostile_files import deep

ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(), inner),
)


@given(message=st.text(), remedy=st.text(), times=st.integers(1, 10_000))
def test_user_error_is_short_and_printable(message: str, remedy: str, times: int) -> None:
    text = str(UserError(f"first{message * times}last", remedy * times))
    assert len(text) <= 2000 and text.startswith("first") and "last" in text
    assert text.encode().decode() == text and all(c.isprintable() or c == "\n" for c in text)


def test_user_error_and_quoted_keep_plain_text() -> None:
    assert (
        str(UserError("Größe 5 µs → 日本\nzwei", "so")) == "Größe 5 µs → 日本\nzwei\n  remedy: so"
    )
    assert str(UserError("\x1b[2J\x07 a\0b \udcff \u202egpj.exe \x9b31m a\rb\tc")).isprintable()
    for value in (3, -2.5, "a b", None, True, [1, 2], {"a": 1}):
        assert quoted(value) == repr(value)


@given(ANY | st.sampled_from([deep(20_000), deep(20_000, as_list=False), -(10**5000), "x" * 10**6]))
def test_quoted_shows_any_value(value: object) -> None:
    assert quoted(value).isprintable() and len(quoted(value)) <= 130
