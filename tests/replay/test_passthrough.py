"""JPEGs of a source go to disk unchanged: the recording equals the camera's or file's data byte for byte."""

import json
from pathlib import Path
from typing import Any

import cv2

from lfpipe.sequence.folder import Sequence, open_sequence
from lfpipe.sequence.packets import INDEX
from lfpipe.transport import control
from tests.world import World

SMALL = ("--set", "camera.width_px=320", "--set", "camera.height_px=240")


def _same(sequence: Sequence, given: list[bytes]) -> bool:
    return all(sequence.data(p.seq) == given[p.source_seq % len(given)] and p.codec == "jpeg" for p in sequence.packets)


def test_jpegs_of_another_size_stay_and_replay_as_they_were_tracked(world: World, short: Path, blocks: Path) -> None:
    folder, out = world.root / "jpegs", world.root / "rec"
    folder.mkdir()
    given = []
    for number, frame in ((k, open_sequence(short).frame(k)) for k in range(12)):
        big = cv2.resize(frame, (400, 300), interpolation=cv2.INTER_CUBIC)
        given.append(cv2.imencode(".jpg", big, [cv2.IMWRITE_JPEG_QUALITY, 85 + number % 10])[1].tobytes())
        (folder / f"{number}.jpg").write_bytes(given[-1])
    done = world.run("record", out, "--camera", f"file:{folder}?loop=0&pace=30", *SMALL)
    assert done.returncode == 0, done.stderr
    recorded = open_sequence(out)
    assert (recorded.width_px, recorded.height_px) == (400, 300) and len(recorded.packets) > 3 and _same(recorded, given)
    assert set(recorded.manifest["checksums"]) == {INDEX}
    runs = []
    for name in ("one", "two"):
        done = world.run("replay", out, "--scene", blocks, "--out", world.root / name)
        assert done.returncode == 0, done.stderr
        runs.append(json.loads((world.root / name / "report.json").read_text()))
    assert runs[0]["digests"] == runs[1]["digests"]
    assert runs[0]["config"]["camera"]["width_px"] == 320, "the size that was tracked, not that of the JPEGs"


def test_a_live_session_lends_the_ring_only_while_it_records_each_whole(world: World, short: Path, blocks: Path) -> None:
    given = [open_sequence(short).data(k) for k in range(60)]
    outs = [world.root / f"rec{number}" for number in range(3)]

    def recorder() -> dict[str, Any]:
        return world.monitor()["stages"]["record"]

    def ask(path: object) -> None:
        assert control.request(next(world.run_dir.glob("lfpipe-*")), {"cmd": "record", "path": str(path)}, 60)["ok"]

    world.up(blocks, *SMALL, camera=f"file:{short}?loop=1&pace=60")
    world.pictures(3)
    for number, out in enumerate(outs):
        assert world.segments("packets") == []
        ask(out)
        assert len(world.segments("packets")) == 1
        world.wait_for(lambda out=out: (out / INDEX).exists() and (out / INDEX).read_text().count("\n") > 20, "frames")
        ask("")
        if number:  # the second one follows at once; before the third, so many frames pass without a recording
            world.wait_for(lambda: recorder()["state"] == "FINISHED", "end of the recorder")
            missed = recorder()["dropped"]
            world.pictures(len(world.lines()) + 120)
    sequences = [open_sequence(out) for out in outs]
    assert all(sequence.complete and _same(sequence, given) for sequence in sequences)
    assert recorder()["restarts"] == 0 and recorder()["count"] == sum(len(sequence.packets) for sequence in sequences)
    assert recorder()["dropped"] - missed < 30, "frames between two recordings are not lost"
