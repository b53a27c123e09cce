"""Every command line that README, docs/ and messages print exists, and runs as printed."""

import ast
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest

from lfpipe import config
from lfpipe.cli import cli
from lfpipe.plugins import COMMANDS, plugins
from tests.docs.conftest import PAGES, ROOT, blocks
from tests.support import extras
from tests.support.source import nodes
from tests.support.world import World

REPLAY = "examples/replay.yml"


def texts() -> Iterator[tuple[str, list[str], bool]]:
    """(page or module, command lines of one shell block or one text, whether it is a block)."""
    for page in PAGES:
        for block in (*blocks(page, "sh"), *blocks(page, "")):
            yield page, block.splitlines(), True
        text = re.sub("^#.*$", "", (ROOT / page).read_text(), flags=re.M)  # usage of commands
        yield page, re.findall(r"`((?:uv run )?(?:lfpipe|python -m) [^`]+)`", text), False
    (folded,) = re.findall(r"^ +(lfpipe .+(?:\n +--.+)*)", (ROOT / REPLAY).read_text(), re.M)
    yield REPLAY, [" ".join(folded.split())], False
    for module, node in nodes(ast.expr):
        if isinstance(node, ast.JoinedStr | ast.Constant):
            # what a message fills in: an option after a word, else an argument
            text = re.sub(r"(?<=\w)\{[^}]*\}", "", ast.unparse(node)).replace("\\n", " ")
            text = re.sub(r"\{[^}]*\}", "NAME", text)
            named = re.findall(r"`(lfpipe (?![A-Z])[^`]+)`", text)
            yield f"lfpipe/{module}", [" ".join(line.split()) for line in named], False


def commands() -> dict[str, tuple[str, bool]]:
    """Command lines of pages and messages in their order, each with the first place that prints it
    and whether it stands in a block there: elsewhere it may only name a command.
    """
    found: dict[str, tuple[str, bool]] = {}
    for place, lines, block in texts():
        for line in lines:
            for part in re.split(r"&&|\|\||;| \| ", line.split(" #")[0]):
                words = re.sub(r"^(\S*uv run|ssh HOST) ", "", part.strip())
                if words.startswith(("lfpipe ", "python -m ")) and not of_missing_extras(words):
                    found.setdefault(words, (place, block))
    return found


def of_missing_extras(line: str) -> bool:
    """Whether a command line uses an extra that is not there."""
    if extras.PRESENT:
        return False
    _, *words = line.split()
    places = {".".join(words[:n]) for n in (1, 2)}
    options = {f"{words[0]}.{word.partition('=')[0]}" for word in words if word.startswith("--")}
    return not (places | options).isdisjoint(plugins(COMMANDS))


def test_docs_commands_exist_with_their_options() -> None:
    context = click.Context(cli)
    for line, (page, _) in commands().items():
        if line.startswith("python -m "):  # tests/bench/test_commands.py: it says how it is used
            file = f"{line.split()[2].replace('.', '/')}.py"
            assert line.split()[2] == "pytest" or (ROOT / file).exists(), f"{page}: {line}"
            continue
        words = [word for word in shlex.split(line)[1:] if word not in ("...", "…", "-v")]
        command: click.Command | None = cli
        while isinstance(command, click.Group) and words and not words[0].startswith("-"):
            command = command.get_command(context, words.pop(0))
            assert command is not None, f"{page}: {line}: there is no such command"
        assert command is not None
        options = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        for name in (word.split("=")[0] for word in words if word.startswith("--")):
            assert name in options or isinstance(command, click.Group), f"{page}: {line}: no {name}"
        for key, value in re.findall(r"(?:--set |ctl set |^)([a-z]+\.[a-z_]+)=(\S+)", line):
            assert key in config.options(), f"{page}: {line}: no key {key}"
            if re.search("[a-z0-9]", value):
                config.load(sets=[f"{key}={value}"])


# Names on the pages for which the small scene stands
SCENES = "SCENE PATH views boxes antinous rectified Bikes buddha raster pair slide-views photo.jpg"
SCENES += " flower_eslf.png path/to/views demo:marbles"
ELSEWHERE = {  # commands that are not run here, and why
    r"--(web|kiosk|on|latency)\b|calibrate|kiosk": "runs until somebody ends it",
    r"cameras|record$|camera:0": "needs a camera",
    r"live:": "needs a camera, or a program: tests/pipeline/test_live_field.py",
    r"models get|10\.0\.0\.7": "needs a network",
    r"scenes/|lf\.h5|slide\.mp4": "needs more than a small scene",
    r"scene describe": "writes to the folder of views",
    r"bench table|scene make": "needs more than a small scene",
    r"lsl|share stop": "needs a library, or a target: tests/extras/share",
    r"\b(WORD|KEY|NAME|OUT|REF|FILE|TARGET|HOST|SRC|V\?pace)\b|\[|\.\.\.": "needs an argument",
    r"--(session|set|out|trace)$": "names an option",
    r"\bctl stop": "others need the session",
    r"desktop": "writes to the home folder",
    r"bench .": "takes minutes",
    r"^python": "tests/bench/test_commands.py: its --help",
    r"up --demo": "tests/docs/test_first_commands.py, tests/cli/test_outputs.py",
}


def runnable() -> dict[str, tuple[str, bool]]:
    """Those of `commands` that end by themselves here. Of those that differ only in the name of the
    scene, which is the same small one for all names, or in a checked value, the first.
    """
    found: dict[str, tuple[str, tuple[str, bool]]] = {}
    names = SCENES.split()
    for line, place in commands().items():
        if not any(re.search(why, line) for why in ELSEWHERE):
            plain = re.sub(r"( -v| --set \S+)(?= |$)", "", line)
            words = ("SCENE" if word.strip("/") in names else word for word in plain.split())
            found.setdefault(" ".join(words), (line, place))
    return dict(found.values())


HIDDEN = shutil.ignore_patterns("cache", "settings", "state", "trace.jsonl")


def ending(line: str) -> list[str]:
    """The arguments of Python that run a command so that it ends without a camera or a screen."""
    words = [word.rstrip("/") for word in shlex.split(line)[1:]]
    words = ["SCENE" if word in SCENES.split() else word for word in words]
    if words[:2] == ["sequence", "cut"] and "--from" in words:
        words[-3::2] = ["0", "0.1"]  # of a short one, which a busy machine makes shorter
    if "up" in words[:2]:
        words += ["--duration", "0.5", "--session", "other"]
        words += [] if "--no-picture" in words else ["--display", "none"]
    if "up" in words[:2] or words[0] == "record":
        words += [] if "--camera" in words else ["--camera", "demo"]
    if words[0] == "record":
        words += ["--duration", "0.5"]
    if words[0] == "monitor":
        words += ["--once"]
    return ["-m", "lfpipe", *words]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, scene: Path, clip: Path) -> Iterator[World]:
    """A running session, and what the pages' commands find in their folder."""
    with World(tmp_path_factory.mktemp("commands")) as made:
        (made.root / "tests").mkdir()
        for name in ("SCENE", "tests/views"):
            (made.root / name).symlink_to(scene)
        for name in ("me.avi", "VIDEO"):
            (made.root / name).symlink_to(clip)
        np.save(made.root / "views.npy", np.zeros((3, 3, 48, 64, 3), np.uint8))
        plan = 'sequences = ["walk"]\nscenes = ["SCENE"]\nsubjects = ["replay"]\n'
        (made.root / "plan.toml").write_text(plan)
        made.done("sequence", "import", clip, "walk")
        for name in ("talk", "tests/walk"):
            shutil.copytree(made.root / "walk", made.root / name)
        slow = [f"--set={key}.rate_hz=10" for key in ("camera", "render")]
        made.shows(scene, scene, *slow, pictures=1)
        yield made


@pytest.mark.nightly
@pytest.mark.parametrize("page", [*PAGES, "lfpipe/"])
def test_docs_commands_run_as_printed(session: World, tmp_path: Path, page: str) -> None:
    """Each of `runnable`, in the order of the page, while a session runs."""
    lines = {line: block for line, (place, block) in runnable().items() if place.startswith(page)}
    if not lines:
        return
    folder = tmp_path / "here"
    shutil.copytree(session.root, folder, symlinks=True, ignore=HIDDEN)
    env = session.env | {"LFPIPE_SESSION": session.name}
    wrong = []
    stop = [sys.executable, "-m", "lfpipe", "trace", "stop"]  # that of the page before
    subprocess.run(stop, cwd=folder, env=env, capture_output=True)
    for line, block in lines.items():
        if re.search(r"record (start )?[\w/]*walk|import", line):
            shutil.rmtree(folder / ("tests/walk" if "tests/walk" in line else "walk"))
        done = subprocess.run(
            [sys.executable, *ending(line)],
            cwd=folder,
            env=env,
            capture_output=True,
            text=True,
            timeout=300,
        )
        answer = done.stdout + done.stderr
        if not block and done.returncode == 2 and re.search("Usage:|no SCENE", answer):
            continue  # the text only names the command
        if done.returncode and not (line == "lfpipe doctor" and done.returncode == 1):
            wrong.append(f"{line}: {done.returncode}\n{answer[-600:]}")
    assert not wrong, "\n".join(wrong)
