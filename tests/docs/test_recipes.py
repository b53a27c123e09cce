"""The programs of docs/recipes.md run on the data of a session."""

import asyncio
import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lfpipe.share.output import LslOutput, Sample, osc_datagram
from lfpipe.share.target import Target
from lfpipe.transport.clock import now_ns
from tests.docs.conftest import blocks
from tests.share.receivers import free_port, lsl_environment
from tests.share.test_outputs import HEAD


def program(word: str) -> str:
    """The block of Python that holds word."""
    return next(block for block in blocks("docs/recipes.md") if word in block)


def test_the_window_keeps_the_screen_where_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    exec(program("window_projection"), names)
    assert capsys.readouterr().out.strip() == "[1. 1.]"
    made = names["window_projection"]
    for eye in ((0, 0, 600), (120, -80, 450), (-200, 60, 900)):
        projection, view = made(eye, (530, 300))  # type: ignore[operator]
        for corner in ((-265, -150), (265, -150), (-265, 150)):
            seen = projection @ view @ (*corner, 0, 1)
            np.testing.assert_allclose(seen[:2] / seen[3], np.sign(corner), atol=1e-9)
        behind = projection @ view @ (*eye[:2], -300, 1)  # straight ahead of the eye
        at_screen = projection @ view @ (*eye[:2], 0, 1)
        np.testing.assert_allclose(behind[:2] / behind[3], at_screen[:2] / at_screen[3], atol=1e-9)


def test_the_bridge_passes_eyes_on_to_a_page(tmp_path: Path) -> None:
    from tornado.websocket import websocket_connect

    osc_port, web_port = free_port(), free_port()
    words = [sys.executable, "-c", program("WebSocketHandler"), str(osc_port), str(web_port)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline().strip() == "passing on"

            async def heard() -> dict[str, list[float]]:
                connection = await websocket_connect(f"ws://127.0.0.1:{web_port}/eyes")
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                    sender.sendto(osc_datagram(Sample(1, 2, 3, HEAD)), ("127.0.0.1", osc_port))
                message = await asyncio.wait_for(connection.read_message(), 60)
                connection.close()
                return dict(json.loads(message or ""))

            message = asyncio.run(heard())
        finally:
            process.kill()
    assert message["left"] == pytest.approx(HEAD.left_mm) and message["right"] == pytest.approx(HEAD.right_mm)


def test_the_experiment_reads_eyes_on_its_own_clock(tmp_path: Path) -> None:
    pytest.importorskip("pylsl")
    os.environ |= lsl_environment(tmp_path)
    name = f"lab{os.getpid()}"
    output, example = LslOutput(Target("lsl", name=name), "recipe", 30.0, True), program("lab-eyes")
    command = [sys.executable, "-c", example.replace("lab-eyes", f"{name}-eyes")]
    try:
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            for seq in range(3000):
                output.send(Sample(seq, now_ns(), now_ns(), HEAD))
                time.sleep(0.02)
                if process.poll() is not None:
                    break
            process.kill()
            out, err = process.communicate()
    finally:
        output.close()
    lines = out.splitlines()
    assert len(lines) == 10 and all(line.split()[:3] == ["-40.0", "5.0", "600.0"] for line in lines), err
