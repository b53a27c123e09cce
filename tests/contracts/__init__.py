"""Examples of each contract, which tests compare with the code and with docs/contracts.md: neither
can change alone.

    trace.json         a line of the trace, as the page shows it
    eyes.bin/.json     a record of the ring "eyes", and its fields
    tap.json           a message of each topic, without `v`
    wire_format.json   requests and answers, monitor --json, and metrics

tests/replay/reference has a report.
"""

import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent


def contract(name: str) -> Any:
    """The content of a file of examples."""
    return json.loads((FOLDER / name).read_text())
