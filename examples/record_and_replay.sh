#!/bin/sh
# Records a camera, replays the recording twice and checks that both runs agree.
if [ $# != 2 ]; then
  echo "Usage: record_and_replay.sh SCENE CAMERA" >&2
  exit 1
fi
set -eu
lfpipe record walk --camera "$2" --duration 2
lfpipe sequence info walk
lfpipe replay walk --scene "$1" --expect reference --update
lfpipe replay walk --scene "$1" --expect reference
