"""Two hosts as network namespaces, each with two workers: timed cells are alone on their host."""

import itertools
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.sweep.conftest import write_plan
from tests.world import World

PLAN = """
scenes = ["CORPUS/scenes/s[0-3]"]
subjects = ["quality", "table"]
[table]
border = [4, 6]
"""
pytestmark = pytest.mark.live
# The bridge and the scheduler are in a network namespace of their own, too: nothing of the machine's network is touched.
SCRIPT = r"""
mount -t tmpfs tmpfs /run || exit 77
mkdir -p /run/netns
ip link set lo up && ip link add br0 type bridge && ip addr add 10.99.0.1/24 dev br0 && ip link set br0 up || exit 77
for n in 2 3; do
  ip netns add h$n && ip link add v$n type veth peer name eth0 netns h$n && ip link set v$n master br0 up || exit 77
  ip -n h$n addr add 10.99.0.$n/24 dev eth0 && ip -n h$n link set eth0 up && ip -n h$n link set lo up || exit 77
done
[ -z "$TRY" ] || exit 0
"$PYTHON" -m distributed.cli.dask_scheduler --host 10.99.0.1 --port 8786 --no-dashboard 2>/dev/null &
for n in 2 3; do for k in a b; do
  ip netns exec h$n "$PYTHON" -m distributed.cli.dask_worker tcp://10.99.0.1:8786 --host 10.99.0.$n --nthreads 1 \
    --resources quiet=1 --no-dashboard --local-directory w$n$k 2>/dev/null &
done; done
"$PYTHON" -c "import sys; from distributed import Client; Client('tcp://10.99.0.1:8786', timeout=60).wait_for_workers(4, 60)"
"$PYTHON" -m lfpipe sweep plan.toml --out out --insecure --on tcp://10.99.0.1:8786
code=$?
kill $(jobs -p); wait
exit $code
"""


def _in_namespaces(**more: object) -> subprocess.CompletedProcess[str]:
    command = ["unshare", "-n", "-m", "--propagation", "private", "bash", "-c", SCRIPT]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=110, **more)  # type: ignore[call-overload,no-any-return]


def _why_not() -> str:
    if not (shutil.which("unshare") and shutil.which("ip")):
        return "needs unshare and ip"
    tried = _in_namespaces(env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "TRY": "1"})
    return f"no network namespaces here: {tried.stderr.strip()[:200]}" if tried.returncode else ""


def test_timed_cells_have_their_host_to_themselves(world: World, corpus: Path) -> None:
    if why := _why_not():
        pytest.skip(why)
    write_plan(world.root, corpus, PLAN)
    done = _in_namespaces(env=world.env | {"PYTHON": sys.executable}, cwd=world.root)
    assert done.returncode == 0, done.stdout + done.stderr
    found = [json.loads(line) for line in (world.root / "out" / "results.jsonl").read_text().splitlines()]
    assert len(found) == 16 and {one["state"] for one in found} == {"ok"}
    timed = [one for one in found if one["subject"] == "table"]
    assert {one["host"] for one in timed} == {"10.99.0.2", "10.99.0.3"}, "both hosts work"
    for host in ("10.99.0.2", "10.99.0.3"):
        spans = sorted((one["began_s"], one["began_s"] + one["seconds"]) for one in timed if one["host"] == host)
        assert all(a[1] <= b[0] for a, b in itertools.pairwise(spans)), "never two at once on one host"
    assert min(one["began_s"] for one in timed) >= max(o["began_s"] + o["seconds"] for o in found if o["subject"] == "quality")
