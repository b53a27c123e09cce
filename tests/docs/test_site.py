"""The pictures of the docs show what there is."""

import json
from pathlib import Path

from tests.support.extras import with_extras

ROOT = Path(__file__).parents[2]


@with_extras
def test_pictures_of_the_docs_show_the_interface_of_today() -> None:
    """The letters of another version of pygame-ce are drawn otherwise."""
    from tools.make_docs_pictures import digests

    stored = json.loads((ROOT / "docs" / "pictures.json").read_text())
    now = digests()
    for digest_of in (stored, now):
        if stored["pygame-ce"] != now["pygame-ce"]:
            del digest_of["window"]
    stored["pygame-ce"] = now["pygame-ce"]
    assert now == stored, "python -m tools.make_docs_pictures monitor window interface"
