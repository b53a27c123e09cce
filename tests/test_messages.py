"""Each refusal once: its cause, the beginning of its message and key words of its remedy, with `…`
for text in between. Each package has its rows in `messages.py` of its tests. Other tests assert the
class of the error, the exit code and the named object, never the sentence.
"""

import importlib
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from lfpipe.errors import UserError

Cause = Callable[[Path], object]
TESTS = Path(__file__).parent
MODULES = [
    ".".join(("tests", *path.relative_to(TESTS).with_suffix("").parts))
    for path in sorted(TESTS.rglob("messages.py"))
]
ROWS: dict[str, tuple[Cause, str]] = {
    f"{module}: {name}": row
    for module in MODULES
    for name, row in importlib.import_module(module).MESSAGES.items()
}


@pytest.mark.parametrize("name", ROWS)
def test_message(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cause is called without a screen in an empty folder, which the text calls `/here`."""
    cause, text = ROWS[name]
    for variable in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("LFPIPE_RUN_DIR", str(tmp_path))  # without the sessions of others
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError) as error:
        cause(tmp_path)
    said = str(error.value).replace(str(tmp_path), "/here")
    assert error.value.remedy and re.match(
        ".*".join(map(re.escape, text.split(" … "))), said, re.DOTALL
    ), said
