"""Every file that the program writes goes through `lfpipe.files.safe_files`; what writes in another
way is listed here, with the reason why no file of a person can be in its place.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import lfpipe
from tests.support.extras import PRESENT

PACKAGE = Path(lfpipe.__file__).parent
WRITERS = """
    write_text write_bytes truncate tofile savez savez_compressed savetxt savefig imwrite
    imwritemulti memmap open_memmap mkstemp NamedTemporaryFile FileHandler RotatingFileHandler
    copyfileobj copytree make_archive unpack_archive mkfifo mknod symlink_to hardlink_to
"""
# names that others have, too
OWNED = "link symlink touch copy copy2 copyfile move dump save VideoWriter FileStorage"
OWNERS = "os p path shutil np first cv2 json pickle tomlkit"
WRITING_FLAGS = "O_CREAT O_WRONLY O_RDWR O_TRUNC O_APPEND"
SAFE = "files/safe_files.py"
ALLOWED = {
    "api/scenes.py": "into the file of `replaced`",
    "bench/charts.py": "into memory",
    "cli/sequence.py": "into a file that it has just made",
    "extras/export/pictures.py": "into memory, or the file of its caller",
    "files/video_writer.py": "FFmpeg opens an OutputFile by its random name, or by its descriptor",
    "host/file_lock.py": "locks: never followed, never written",
    "host/files.py": "reserves room in a file that its caller has just made",
    "host/processes.py": "/proc/self/comm",
    "host/segment.py": "shared memory",
    "host/terminal.py": "/dev/null",
    "host/wake.py": "a FIFO in the run directory",
    "capture/v4l2_device.py": "a device",
    "log.py": "the log in the run directory, which only its owner can enter",
    "replays/run.py": "copies into a folder that it has just made",
    "scene/pack.py": "arrays in the folder of a pack that it has just made",
    "sequence/packets.py": "packets in the folder of a recording that it has just made",
    "supervisor/child.py": "a stage's stack, in the run directory",
    "bench/inputs.py": "OpenCV opens an OutputFile by its random name",
}


def _writes(call: ast.Call) -> bool:
    function = call.func
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    texts = [
        node.value
        for argument in (*call.args, *(word.value for word in call.keywords))
        for node in ast.walk(argument)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    if name in ("open", "fdopen", "ZipFile", "TarFile", "File", "GzipFile"):
        # the mode is the only short text of these letters
        modes = [text for text in texts if 0 < len(text) < 4 and not set(text) - set("rwxabt+")]
        flags = {node.attr for node in ast.walk(call) if isinstance(node, ast.Attribute)}
        in_memory = any(isinstance(a, ast.Name) and a.id == "data" for a in call.args)
        writing = any(set(mode) & set("wxa+") for mode in modes)
        return not in_memory and (writing or bool(flags & set(WRITING_FLAGS.split())))
    owner = function.value if isinstance(function, ast.Attribute) else None
    if name in OWNED.split():
        return isinstance(owner, ast.Name) and owner.id in OWNERS.split()
    return name in WRITERS.split()


def writers(source: str) -> list[int]:
    """Lines of calls that write a file."""
    calls = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call))
    return [call.lineno for call in calls if _writes(call)]


def _all() -> Iterator[tuple[str, list[int]]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        if lines := writers(path.read_text()):
            yield path.relative_to(PACKAGE).as_posix(), lines


def test_every_writer_is_the_safe_one_or_listed() -> None:
    found = dict(_all())
    assert {name: found[name] for name in found.keys() - {SAFE, *ALLOWED}} == {}
    listed = {name for name in ALLOWED if PRESENT or not name.startswith("extras/")}
    assert listed <= set(found), "what writes nothing any more leaves the list"
