"""Recording: beside a live session, alone, cut off by SIGKILL; and played again."""

import itertools
import json
import os
import signal
import stat
import time
from pathlib import Path

import numpy as np
import pytest

from lfpipe.sequence.folder import open_sequence
from tests.world import World

SMALL = ("--set", "camera.width_px=320", "--set", "camera.height_px=240")


@pytest.mark.everyday
def test_a_live_session_is_recorded_without_a_hole(world: World, short: Path, blocks: Path) -> None:
    out = world.root / "rec"
    process = world.up(blocks, *SMALL, camera=f"file:{short}?loop=1&pace=60", preexec_fn=lambda: os.umask(0))
    world.pictures(5)

    def ctl(*words: str | Path) -> dict[str, object]:
        done = world.run("ctl", "--session", world.name, "--json", "record", *words)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    assert ctl("start", out)["path"] == str(out)
    second = world.run("ctl", "--session", world.name, "record", "start", world.root / "other")
    assert second.returncode == 2 and "is already running" in second.stderr
    world.wait_for(lambda: (out / "frames.jsonl").exists() and (out / "frames.jsonl").read_text().count("\n") > 60, "recording")
    stage = world.monitor()["stages"]["record"]
    assert stage["state"] == "RUNNING" and stage["dropped"] == 0
    ctl("stop")
    world.wait_for(lambda: json.loads((out / "manifest.json").read_text())["complete"], "manifest")
    stopped = world.monitor()
    world.pictures(len(world.lines()) + 5)  # the session continues
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0 and f"recorded {len(open_sequence(out).packets)} frames" in err
    sequence = open_sequence(out)
    source = open_sequence(short)
    seqs = [packet.source_seq for packet in sequence.packets]
    for packet in itertools.islice(sequence.packets, 10):
        assert np.array_equal(sequence.frame(packet.seq), source.frame(packet.source_seq % 60))
    let_go, missed = (stopped["stages"][name]["dropped"] for name in ("capture", "record"))
    assert sequence.lost <= let_go + missed, "every hole is counted, of the source as of the recorder"
    assert missed <= 0.02 * len(seqs), "that no frame is missed is measured in profiling/replay_recording.py"
    assert {stat.S_IMODE(path.stat().st_mode) for path in out.iterdir()} == {0o600} and stat.S_IMODE(out.stat().st_mode) == 0o700


def test_recorded_and_replayed_stamps_and_rate_agree(world: World, short: Path, blocks: Path) -> None:
    out = world.root / "rec"
    done = world.run("record", out, "--camera", f"file:{short}?loop=1&pace=60", "--duration", "3", *SMALL)
    assert done.returncode == 0 and "recorded" in done.stderr, done.stderr
    sequence = open_sequence(out)
    counted = sequence.packets[-1].source_seq - sequence.packets[0].source_seq
    assert counted > 60 and counted / sequence.duration_s == pytest.approx(60, rel=0.01)
    replayed = world.root / "out"
    args = ("--scene", blocks, "--pace", "recorded", "--out", replayed, "--set", "render.clock=camera")
    done = world.run("replay", out, *args)
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in (replayed / "trace.jsonl").read_text().splitlines()]
    recorded = np.array([packet.t_sensor_ns for packet in sequence.packets])
    seen = [line["source_seq"] for line in lines]
    played = np.array([line["t_sensor_ns"] for line in lines])
    assert np.abs((played - played[0]) - (recorded[seen] - recorded[seen[0]])).max() < 1000
    read = [line["t_read_ns"] for line in lines]
    recorded_s, replayed_s = (recorded[seen[-1]] - recorded[seen[0]]) / 1e9, (read[-1] - read[0]) / 1e9
    assert replayed_s > 2 and replayed_s == pytest.approx(recorded_s, rel=0.01), "the same frames in the same time"
    report = json.loads((replayed / "report.json").read_text())
    assert report["counts"]["frames_shown"] + sum(report["counts"]["dropped"].values()) >= len(recorded)
    assert report["digests"] is None


def test_a_recording_cut_off_by_sigkill_is_whole_to_its_last_frame(world: World, short: Path, blocks: Path) -> None:
    out = world.root / "rec"
    process = world.start("record", out, "--camera", f"file:{short}?loop=1&pace=60", *SMALL, start_new_session=True)
    world.wait_for(lambda: (out / "frames.jsonl").exists() and (out / "frames.jsonl").read_text().count("\n") > 20, "frames")
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    time.sleep(0.2)
    sequence = open_sequence(out)
    assert not sequence.complete and len(sequence.packets) > 20
    check = world.run("sequence", "check", out)
    assert check.returncode == 0 and "cut off" in check.stdout
    replayed = world.run("replay", out, "--scene", blocks)
    assert replayed.returncode == 0, replayed.stderr
    assert f"replaying its {len(sequence.packets)} whole frames" in replayed.stderr
