"""The examples of the contracts against the code, and against the pages that describe them."""

import re

import numpy as np

from lfpipe.eyes import EYES, EyesRecord
from lfpipe.transport import ring
from tests.contracts import FOLDER, contract

DOCS = FOLDER.parents[1] / "docs"
PAGE = (DOCS / "contracts.md").read_text()
OF_EVERY_ANSWER = {"v", "ok", "cmd", "rev", "id", "applied", "error", "remedy"}


def section(name: str) -> str:
    """The text of a section of the page."""
    return PAGE.partition(f"\n## {name}\n")[2].partition("\n## ")[0]


def test_page_shows_the_trace_line() -> None:
    assert f"```json\n{(FOLDER / 'trace.json').read_text()}```\n" in section("Trace")


def test_eyes_record_has_the_bytes_of_the_contract() -> None:
    """As the code reads them, and as a reader does who has only the page."""
    data = (FOLDER / "eyes.bin").read_bytes()
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \| ([fi]\d)(?: (\(.*?\)))? \|", PAGE, re.M)
    of_page = np.dtype(
        [
            (name, f"<{kind}", tuple(map(int, re.findall(r"\d+", shape))))
            for names, kind, shape in rows
            for name in re.findall(r"\w+", names)
        ]
    )
    expected = contract("eyes.json")
    for dtype in (EYES, of_page):
        (record,) = np.frombuffer(data, dtype)
        assert {name: record[name].tolist() for name in dtype.names or ()} == expected
    made = np.zeros((), EYES)
    EyesRecord.of(np.frombuffer(data, EYES)[0]).write(made)
    made["head_px"] = expected["head_px"]
    assert made.tobytes() == data


def test_page_lists_the_fields_of_every_topic() -> None:
    messages = contract("tap.json")
    rows = {row.split("`")[1]: row for row in section("Tap").splitlines() if row.startswith("- `")}
    assert rows.keys() == {message["topic"] for message in messages}
    for message in messages:
        fields = message.keys() - {"topic", "t_ns", "stage"}
        assert all(f"`{field}`" in rows[message["topic"]] for field in fields), message


def test_stamps_have_the_numbers_of_the_page() -> None:
    words = ["scheduled", "read", "end of frame", "start of exposure", "start of transfer"]
    assert [(one.value, one.word) for one in ring.StampKind] == list(enumerate(words))


def test_page_names_the_fields_of_each_answer() -> None:
    rows = {
        name: row
        for row in section("Control").splitlines()
        if row.startswith("| `")
        for name in re.findall(r"`(\w+)`", row.split("|")[1])
    }
    for pair in contract("wire_format.json")["requests and answers of a session"]:
        command = pair["request"]["cmd"]
        if not pair["answer"]["ok"] or command == "status":
            continue
        request, answer = (rows[command].split("|")[k] for k in (2, 3))
        for text, fields in (
            (request, pair["request"].keys() - {"v", "cmd", "id"}),
            (answer, pair["answer"].keys() - OF_EVERY_ANSWER),
        ):
            assert all(f"`{field}`" in text for field in fields), (command, fields)
