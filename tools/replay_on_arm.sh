#!/bin/sh
# Replays the reference of tests/replay on an emulated ARM machine: Debian arm64 in a folder, run by qemu-user. Needs root, and
# debootstrap, qemu-user-static and binfmt-support from apt. Takes an hour, most of it packing the scene. Once per release.
#
#     tools/replay_on_arm.sh SEQ SCENE REFERENCE [OPTION...]
#
# As for `lfpipe replay SEQ --scene SCENE --expect REFERENCE OPTION...`. The system stays in LFPIPE_ARM_ROOT for the next run.
set -eu
export TMPDIR=/tmp  # of the system in the folder, too

[ $# -ge 3 ] || { sed -n '2,8p' "$0"; exit 2; }
sequence=$(realpath "$1") scene=$(realpath "$2") reference=$(realpath "$3")
shift 3
root=${LFPIPE_ARM_ROOT:-/var/tmp/lfpipe-arm64}
source=$(realpath "$(dirname "$0")/..")
commands="debootstrap qemu-aarch64-static"
for command in $commands; do
    command -v "$command" > /dev/null || { echo "error: $command is missing: apt-get install debootstrap qemu-user-static" >&2; exit 2; }
done
[ "$(id -u)" = 0 ] || { echo "error: chroot needs root" >&2; exit 2; }

if [ ! -e "$root/opt/ready" ]; then
    debootstrap --arch=arm64 --foreign --variant=minbase bookworm "$root"
    cp "$(command -v qemu-aarch64-static)" "$root/usr/bin/"
    chroot "$root" /debootstrap/debootstrap --second-stage
    chroot "$root" apt-get install -y --no-install-recommends python3-venv libgl1 libglib2.0-0 libatomic1
    chroot "$root" python3 -m venv /opt/venv
    touch "$root/opt/ready"
fi

mkdir -p "$root/data" "$root/dev/shm"
mount -t proc proc "$root/proc"
mount -t tmpfs tmpfs "$root/dev/shm"
trap 'umount "$root/dev/shm" "$root/proc"' EXIT
for name in sequence scene reference source; do
    rm -rf "$root/data/$name"
done
cp -r "$sequence" "$root/data/sequence"
mkdir "$root/data/scene"
cp -r "$scene" "$root/data/scene/"  # the reference knows it by its name
cp -r "$reference" "$root/data/reference"
mkdir "$root/data/source"
(cd "$source" && tar -c --exclude=.git --exclude=.venv .) | tar -x -C "$root/data/source"

run() {
    chroot "$root" env HOME=/root LFPIPE_RUN_DIR=/run/lfpipe LFPIPE_SESSION=arm LFPIPE_PATIENCE=8 PATH=/opt/venv/bin:/usr/bin:/bin "$@"
}
mkdir -p "$root/run/lfpipe" && chmod 700 "$root/run/lfpipe"
run pip install --quiet /data/source
run lfpipe models get
run lfpipe doctor || true
# exit code 0: equal within what two kinds of machine may differ by (docs/replay.md)
run lfpipe replay /data/sequence --scene "/data/scene/$(basename "$scene")" --expect /data/reference "$@"
