"""A virtual machine with a Debian kernel and its camera drivers, over this machine's own files: see
README.md.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import attrs

PACKAGES = ("qemu-system-x86", "kmod", "busybox-static", "cpio", "v4l-utils")
TOOLS = (
    "qemu-system-x86_64",
    "modprobe",
    "depmod",
    "busybox",
    "cpio",
    "v4l2-ctl",
    "dpkg-deb",
    "apt-get",
)
MODULES = {
    "boot.list": ("virtio_pci", "9p", "9pnet_virtio", "overlay"),
    "camera.list": ("vivid", "vhci-hcd", "uvcvideo"),
}
BOOT_S = {"kvm": 10.0, "tcg": 90.0}  # a nested machine may have a KVM that never boots
KERNEL_WORDS = "console=ttyS0 loglevel=4 panic=-1"
BOOTED = "LFPIPE-GUEST-UP"  # printed by the guest's init

INIT = """#!/bin/busybox sh
export PATH=/bin; /bin/busybox mkdir -p /bin /proc /sys /dev /low /top /new
/bin/busybox --install -s /bin
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
echo {booted}
while read -r module; do
  insmod /modules/$module || echo "insmod $module failed"
done < /modules/boot.list
share=trans=virtio,version=9p2000.L,msize=262144
mount -t 9p -o $share,ro,cache=loose root /low
mount -t tmpfs -o size=2g top /top; mkdir /top/upper /top/work
mount -t overlay -o lowerdir=/low,upperdir=/top/upper,workdir=/top/work root /new
for each in proc sys dev; do mount --move /$each /new/$each; done
mkdir -p /new/dev/shm /new/run /new/guest
for each in dev/shm run; do mount -t tmpfs tmpfs /new/$each; done
mkdir -p /new/run/modules; cp /modules/* /new/run/modules/
mount -t 9p -o $share out /new/guest
exec switch_root /new /bin/sh /guest/start
"""
START = """export PATH={path} HOME=/root LFPIPE_GUEST=1
export PYTHONDONTWRITEBYTECODE= PYTHONPYCACHEPREFIX=
case {checkout} in /tmp/*) ;; *) mount -t tmpfs tmpfs /tmp ;; esac
cd {checkout}
ip link set lo up 2>/dev/null || busybox ip link set lo up
( {command} ) > /guest/output 2>&1
echo $? > /guest/code
sync
echo o > /proc/sysrq-trigger
sleep 60
"""


class UnavailableError(Exception):
    """The machine cannot run here; the message says why."""


def _call(*words: str | Path, cwd: Path | None = None, timeout_s: float = 300.0) -> str:
    try:
        done = subprocess.run(
            words, cwd=cwd, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnavailableError(f"{words[0]}: {error}") from None
    if done.returncode:
        raise UnavailableError(
            f"{' '.join(map(str, words))}: {(done.stderr or done.stdout).strip()[-200:]}"
        )
    return done.stdout


def install_tools() -> None:
    """Installs missing tools if this user may. Raises UnavailableError."""
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        raise UnavailableError("needs Linux on x86-64")
    missing = [tool for tool in TOOLS if not shutil.which(tool)]
    if not missing:
        return
    if not shutil.which("apt-get"):
        raise UnavailableError(
            f"{', '.join(missing)} not installed, and no apt-get to install them"
        )
    root = [] if os.geteuid() == 0 else ["sudo", "-n"]
    _call(*root, "apt-get", "update", "-qq")
    _call(*root, "apt-get", "install", "-y", "-qq", "--no-install-recommends", *PACKAGES)
    if missing := [tool for tool in TOOLS if not shutil.which(tool)]:
        raise UnavailableError(f"{', '.join(missing)} not installed")


@attrs.frozen
class Kernel:
    """image: what QEMU boots. initrd: busybox, `INIT` and the modules."""

    version: str
    image: Path
    initrd: Path


def _kernel_package() -> str:
    """The Debian package of the present kernel; the cloud kernels have no camera drivers."""
    for line in _call("apt-cache", "depends", "linux-image-amd64").splitlines():
        kind, _, name = line.strip().partition(": ")
        if kind == "Depends" and name.startswith("linux-image-"):
            return name
    raise UnavailableError(
        "apt knows no linux-image-amd64: not a Debian with a kernel for this processor"
    )


def prepare(cache: Path) -> Kernel:
    """Downloads the kernel into cache, once, and packs the initial file system.

    Raises UnavailableError.
    """
    package = _kernel_package()
    version = package.removeprefix("linux-image-")
    folder = cache / version
    image, root = folder / "boot" / f"vmlinuz-{version}", folder / "initrd"
    if not image.exists():
        folder.mkdir(parents=True, exist_ok=True)
        _call("apt-get", "download", package, cwd=folder)
        for archive in folder.glob("*.deb"):
            _call("dpkg-deb", "-x", archive, folder)
            archive.unlink()
        _call("depmod", "-b", folder, version)
    shutil.rmtree(root, ignore_errors=True)
    (root / "bin").mkdir(parents=True)
    modules = root / "modules"
    modules.mkdir()
    shutil.copy(shutil.which("busybox") or "busybox", root / "bin" / "busybox")
    for name, needed in MODULES.items():
        listed: list[str] = []
        for module in needed:
            for line in _call(
                "modprobe", "-d", folder, "-S", version, "--show-depends", module
            ).splitlines():
                source = Path(line.removeprefix("insmod ").strip())
                if line.startswith("insmod ") and source.name not in listed:
                    listed.append(source.name)
                    shutil.copy(source, modules / source.name)
        (modules / name).write_text("".join(f"{each}\n" for each in listed))
    init = root / "init"
    init.write_text(INIT.format(booted=BOOTED))
    init.chmod(0o755)
    initrd = folder / "initrd.cpio"
    _call("sh", "-c", f"find . | cpio -o -H newc --quiet > '{initrd}'", cwd=root)
    return Kernel(version, image, initrd)


def run(kernel: Kernel, command: str, out: Path, limit_s: float) -> tuple[int, str]:
    """Runs command in the guest, in this folder; out is its /guest. Ends the machine after limit_s,
    whatever happens.

    Returns exit code and output. Raises UnavailableError if the guest does not boot, or does not
    finish in time.
    """
    (out / "start").write_text(
        START.format(path=os.environ["PATH"], checkout=Path.cwd(), command=command)
    )
    printed, console = out / "output", out / "console"
    share = "security_model=none,multidevs=remap"
    for accelerator, boot_s in BOOT_S.items():
        words = [
            *(
                "qemu-system-x86_64",
                "-accel",
                accelerator,
                "-cpu",
                "max",
                "-smp",
                "2",
                "-m",
                "4G",
                "-nographic",
                "-no-reboot",
            ),
            *("-kernel", str(kernel.image), "-initrd", str(kernel.initrd), "-append", KERNEL_WORDS),
            *("-virtfs", f"local,path=/,mount_tag=root,readonly=on,{share}"),
            *("-virtfs", f"local,path={out},mount_tag=out,{share}"),
        ]
        with console.open("wb") as log:
            process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
        began = time.monotonic()
        booted = False
        try:
            while process.poll() is None and time.monotonic() < began + (
                limit_s if booted else min(boot_s, limit_s)
            ):
                booted = booted or BOOTED in console.read_text(errors="replace")
                time.sleep(0.2)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(60)
        output = (printed if printed.exists() else console).read_text(errors="replace")
        if (out / "code").exists():
            return (
                int((out / "code").read_text()),
                f"{output}\n{accelerator}, {time.monotonic() - began:.0f} s",
            )
        if booted:
            raise UnavailableError(
                f"the guest did not finish in {limit_s:.0f} s: {output[-2000:].strip()}"
            )
    raise UnavailableError(f"the guest did not boot: {output[-2000:].strip()}")
