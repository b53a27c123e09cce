"""The table of topics against the code that sends them and the page that lists them."""

import ast
from collections import defaultdict
from pathlib import Path

from lfpipe.supervisor.process_table import STAGES
from tests.supervisor.tap_topics import TOPICS
from tests.support.source import nodes

ROOT = Path(__file__).parents[2]


def sent() -> dict[str, set[str]]:
    """Topic -> fields that any line of the package sends with it."""
    fields: dict[str, set[str]] = defaultdict(set)
    for _, call in nodes(ast.Call):
        name = ast.unparse(call.func).rpartition(".")[2]
        first = call.args[0] if call.args else None
        if not (isinstance(first, ast.Constant) and isinstance(first.value, str)) or name not in (
            "emit",
            "_emit",
            "publish",
        ):
            continue
        topic = first.value
        fields[topic] |= {keyword.arg or "" for keyword in call.keywords}
    return dict(fields)


def test_topics_are_those_that_the_code_sends() -> None:
    assert {topic.name: set(topic.fields) for topic in TOPICS} == sent()
    stages = {stage.name for stage in STAGES}
    assert {name for topic in TOPICS for name in topic.writers} <= {
        *stages,
        "every stage",
        "supervisor",
    }


def test_topics_are_listed_in_the_contracts() -> None:
    page = (ROOT / "docs" / "contracts.md").read_text()
    for topic in TOPICS:
        row = f"- `{topic.name}` ({', '.join(topic.writers)}): "
        (line,) = [line for line in page.splitlines() if line.startswith(row)]
        assert all(f"`{field}`" in line for field in topic.fields), line
