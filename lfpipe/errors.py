"""User errors, with the problem and its remedy."""

import json
import re
import reprlib

# A program that starts lfpipe names a file in this variable of the environment: a failed command
# writes its error there.
ERROR_FILE = "LFPIPE_ERROR_FILE"
# a screen of 80x24 holds a message with its remedy
MESSAGE_CHARS, REMEDY_CHARS, VALUE_CHARS = 1500, 400, 60
CREDENTIALS = re.compile(r"(\b[a-z][a-z0-9+.-]{0,15}://)[^/\s]*@", re.I)


class UserError(Exception):
    """An error of the user or their machine, never of the program: printed without traceback, exit
    code 2.

    message names the problem and the value; remedy is how to fix it. Both may quote unchecked names
    and values from files: they are made `plain` and short here, safe for every terminal, log and
    message.
    """

    def __init__(self, message: str, remedy: str = "") -> None:
        self.message = plain(message, MESSAGE_CHARS)
        self.remedy = plain(remedy, REMEDY_CHARS)
        super().__init__(self.message)

    def __str__(self) -> str:
        return f"{self.message}\n  remedy: {self.remedy}" if self.remedy else self.message

    def to_json(self) -> bytes:
        """For another process."""
        return json.dumps({"message": self.message, "remedy": self.remedy}).encode()

    @classmethod
    def from_json(cls, data: bytes) -> "UserError | None":
        """The reverse of `to_json`; None for other data."""
        try:
            plain_error = json.loads(data)
            return UserError(str(plain_error["message"]), str(plain_error["remedy"]))
        except (ValueError, KeyError, TypeError):
            return None


def plain(text: str, most_chars: int = 4 * MESSAGE_CHARS) -> str:
    """text `escaped`, and its middle left out where it is long."""
    return _without_middle(escaped(_without_middle(redacted(text), most_chars)), most_chars)


def escaped(text: str) -> str:
    """text with control characters and lone surrogates escaped, and credentials `redacted`; lines
    remain lines. Whatever lfpipe prints and did not write itself goes through here: a terminal
    obeys escape sequences in names, notices and telemetry.
    """
    text = redacted(text)
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def redacted(text: str) -> str:
    """text without the names and passwords of URLs in it: sources may have some."""
    return CREDENTIALS.sub(r"\1***@", text)


def _without_middle(text: str, most_chars: int) -> str:
    head = most_chars * 2 // 3
    return text if len(text) <= most_chars else f"{text[:head]} ... {text[head + 5 - most_chars :]}"


_short = reprlib.Repr()
_short.maxstring = _short.maxother = VALUE_CHARS
# enough to recognise a value
_short.maxlevel = _short.maxdict = _short.maxlist = _short.maxtuple = _short.maxset = 3


def quoted(value: object) -> str:
    """value as a message quotes it: repr on one line, never long, never an exception, however large
    or deep value is.
    """
    try:
        text = _short.repr(value)
    except ValueError:  # Python refuses to print the longest
        text = "an integer with too many digits"
    return text if len(text) <= 2 * VALUE_CHARS else text[: 2 * VALUE_CHARS] + "..."
