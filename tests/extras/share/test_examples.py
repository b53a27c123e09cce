"""The examples of the docs that receive eyes."""

import asyncio
import itertools
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from lfpipe.extras.share.output import LslOutput, Sample, osc_datagram
from lfpipe.extras.share.target import Target
from lfpipe.transport.clock import now_ns
from tests.docs.conftest import ROOT
from tests.extras.share.receivers import free_port, lsl_environment
from tests.extras.share.test_outputs import HEAD
from tests.support.world import until


def test_eyes_to_page_example_passes_eyes_on(tmp_path: Path) -> None:
    from tornado.websocket import websocket_connect

    osc_port, web_port = free_port(), free_port()
    bridge = ROOT / "examples" / "eyes_to_page.py"
    words = [sys.executable, str(bridge), str(osc_port), str(web_port)]
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
    assert message["left"] == pytest.approx(HEAD.left_mm) and message["right"] == pytest.approx(
        HEAD.right_mm
    )


def test_lsl_example_reads_eyes(tmp_path: Path) -> None:
    pytest.importorskip("pylsl")
    os.environ |= lsl_environment(tmp_path)
    name = f"lab{os.getpid()}"
    output = LslOutput(Target(kind="lsl", name=name), "recipe", 30.0, True)
    command = [sys.executable, str(ROOT / "examples" / "lsl_experiment.py"), name]
    try:
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            seqs = itertools.count()

            def send_until_ended() -> bool:
                output.send(Sample(next(seqs), now_ns(), now_ns(), HEAD))
                return process.poll() is not None

            try:
                until(send_until_ended, "end of the program", 60)
            finally:
                process.kill()
            out, err = process.communicate(timeout=60)
    finally:
        output.close()
    lines = out.splitlines()
    assert len(lines) == 10 and all(
        line.split()[:3] == ["-40.0", "5.0", "600.0"] for line in lines
    ), err
