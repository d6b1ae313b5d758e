#!/usr/bin/env bash
# Package: decord 0.6.0 (PyPI), on a valid MP4 clip of 20 frames that was trimmed without encoding it again, as phones and `ffmpeg -c copy` do it.
# Behaviour: the file's edit list hides the first 4 frames, which only decoding needs, and 16 remain. decord's length is 20: indices 0 to 15 are the 16 frames,
#   16 to 19 are copies of the last. `get_frame_timestamp` begins at -0.4 s, so that each time is 0.4 s too early for its frame. Nothing is raised. With 6
#   of 20 hidden, a warning about corrupted frames appears on standard error; with 4 nothing does.
# Guess beforehand: 16 frames from time 0 on, or all 20, the hidden ones at negative times.
# Valid by: ISO/IEC 14496-12, edit list box, which maps a track's media to the time of presentation. ffmpeg, OpenCV 5.0 and PyAV 18.1 have 16 frames from 0 on.
# Output seen:
#   whole: ffmpeg 20 frames; decord 20 frames from 0.0 s to 1.9 s: 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19
#   trimmed: ffmpeg 16 frames; decord 20 frames from -0.4 s to 1.5 s: 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 19 19 19 19
# Consequence: compared at decord's times, a scene of the same clip looks shifted, and a mean over all indices counts the last frame five times. Read the
#   clip by another library, or encode it again first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 decord==0.6.0 imageio-ffmpeg==0.8.1
ffmpeg=$(venv/bin/python -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())')
# Frame N has the luminance 16 + 10 N.
"$ffmpeg" -v error -f lavfi -i color=c=black:s=64x48:r=10:d=2 -vf "geq=lum='16+10*N':cb=128:cr=128" -c:v libx264 -qp 0 -bf 0 whole.mp4
"$ffmpeg" -v error -ss 0.35 -i whole.mp4 -c copy trimmed.mp4
cat >try.py <<'END'
import sys

import decord

frames = decord.VideoReader(sys.argv[1])
first, last = (float(frames.get_frame_timestamp(i)[0]) for i in (0, len(frames) - 1))
shown = ' '.join(str(round(float(frames[i].asnumpy().mean()) * 219 / 255 / 10)) for i in range(len(frames)))
print(f'decord {len(frames)} frames from {first:.1f} s to {last:.1f} s: {shown}')
END
found=$(for name in whole trimmed; do
  shown=$("$ffmpeg" -v error -i $name.mp4 -fps_mode passthrough -f framecrc - | grep -vc '^#')
  echo "$name: ffmpeg $shown frames; $(venv/bin/python try.py $name.mp4)"
done)
echo "$found"
[ "$found" = 'whole: ffmpeg 20 frames; decord 20 frames from 0.0 s to 1.9 s: 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19
trimmed: ffmpeg 16 frames; decord 20 frames from -0.4 s to 1.5 s: 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 19 19 19 19' ]
