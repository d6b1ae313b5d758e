#!/usr/bin/env bash
# ffmpeg 9: frames that a filter has renumbered at a constant rate are still repeated to fill their former time.
#
# Version: ffmpeg 9.0.2 of PyPI's imageio-ffmpeg 0.8.1. Debian 12's 5.1.9 writes each frame once.
# Behaviour: a video pauses for 2.7 s after its tenth frame. `-vf settb=1/25,setpts=N -r 25` sets every frame's time stamp to its number at the output's rate,
#   so a constant rate should have nothing to repeat. But setpts changes only time stamps. The frame before the pause keeps its duration of 2.7 s. The conversion
#   to a constant rate uses the frames' durations, so the frame is written repeatedly.
# Guess beforehand: 20 frames in, 20 frames out, as with 5.1.
# Seen: 20 frames with `-fps_mode passthrough`; with setpts=N and -r 25 more than 60. The remedy is `-fps_mode passthrough`, which repeats and drops nothing in
#   either version.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check imageio-ffmpeg==0.8.1
ffmpeg=$("$work/venv/bin/python" -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())')
"$ffmpeg" -v error -f lavfi -i testsrc2=s=64x48:r=30 -frames:v 20 -vf "setpts='PTS+if(gte(N,10),2.7/TB,0)'" -fps_mode passthrough \
  -c:v libx264 -bf 0 "$work/pause.mp4"
frames() { "$ffmpeg" -v error -i "$work/pause.mp4" "$@" -f framecrc - | grep -vc '^#'; }
whole=$(frames -fps_mode passthrough)
numbered=$(frames -vf settb=1/25,setpts=N -r 25)
echo "passed through: $whole frames; numbered anew at 25 a second: $numbered frames"
[ "$whole" -eq 20 ] && [ "$numbered" -gt 60 ]
