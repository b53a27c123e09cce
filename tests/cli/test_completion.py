"""Completions on Tab: the real script in a real bash."""

import os
import shutil
import subprocess
import sys

import pytest

from tests.world import World

ASK = """
eval "$({python} -m lfpipe completion bash)"
COMP_LINE='{line}'; COMP_POINT=${{#COMP_LINE}}; COMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
compopt() {{ :; }}
_lfpipe_completion {command}
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def command(tmp_path_factory: pytest.TempPathFactory) -> str:
    """`lfpipe` as a file, as a package installs it."""
    path = tmp_path_factory.mktemp("bin") / "lfpipe"
    path.write_text(f"#!{sys.executable}\nfrom lfpipe.__main__ import main\nmain()\n")
    path.chmod(0o755)
    return str(path)


def offered(world: World, command: str, line: str) -> list[str]:
    script = ASK.format(python=sys.executable, line=line, words="lfpipe x", command=command)
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, cwd=world.root, env=world.env)
    assert not done.stderr, done.stderr
    return done.stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_values_are_offered_behind_what_bash_breaks_words_at(world: World, command: str) -> None:
    (world.root / "boxes").mkdir()
    (world.root / "mine.toml").touch()
    (world.root / "out.mkv").touch()
    for line, wanted in {
        "lfpipe up --demo --set render.me": ["render.method="],
        "lfpipe up --demo --set render.method=wa": ["warp", "warp2"],
        "lfpipe ctl set render.swap_eyes=": ["true", "false"],
        "lfpipe up --set scene.layout=hci": ["hci", "hci-old", "hci-text"],
        "lfpipe up bo": ["boxes/"],
        "lfpipe up --display f": ["fullscreen", "file:"],
        "lfpipe up --display file:o": ["out.mkv"],
        "lfpipe up --config ": ["paper", "boxes/", "mine.toml"],
        "lfpipe record x --camera d": ["demo"],
    }.items():
        found = offered(world, command, line)
        assert [word for word in found if word not in ("run/",)] == wanted, line


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_running_sessions_are_offered(live: World, command: str) -> None:
    assert os.environ.get("XDG_RUNTIME_DIR") != str(live.run_dir)
    assert offered(live, command, "lfpipe ctl --session ") == [live.name]
