#!/usr/bin/env bash
# ffmpeg 9: the GIF demuxer's `min_delay` has no effect.
#
# Version: ffmpeg 9.0.2 of PyPI's imageio-ffmpeg 0.8.1. Debian 12's 5.1.9 applies it.
# Behaviour: `ffmpeg -h demuxer=gif` lists min_delay (2 hundredths of a second by default) and default_delay (10): a frame with a shorter delay is shown for
#   default_delay, as browsers do. Version 9 lists both options with the same defaults and returns the file's delays unchanged, also with `-min_delay 5
#   -default_delay 20`.
# Guess beforehand: four frames with delays of 1/100 s at 0, 0.1, 0.2 and 0.3 s, as with 5.1.
# Output seen:
#   listed: 2 and 10; times 0 0.01 0.02 0.03; with -min_delay 5 -default_delay 20: 0 0.01 0.02 0.03
# Consequence: the same file is ten times as long in one version as in the other.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check imageio-ffmpeg==0.8.1 pillow==13.0.0
"$work/venv/bin/python" - "$work/fast.gif" <<'END'
import sys
from PIL import Image
frames = [Image.new('RGB', (8, 8), (60 * i, 0, 0)) for i in range(4)]
frames[0].save(sys.argv[1], save_all=True, append_images=frames[1:], duration=10)
END
ffmpeg=$("$work/venv/bin/python" -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())')
listed() { "$ffmpeg" -hide_banner -h demuxer=gif | sed -n "s/.*-$1 .*(default \([0-9]*\)).*/\1/p"; }
times() { "$ffmpeg" "$@" -i "$work/fast.gif" -vf showinfo -f null - 2>&1 | grep -o 'pts_time:[0-9.]*' | cut -d: -f2 | xargs; }
found="listed: $(listed min_delay) and $(listed default_delay); times $(times); with -min_delay 5 -default_delay 20: $(times -min_delay 5 -default_delay 20)"
echo "$found"
[ "$found" = 'listed: 2 and 10; times 0 0.01 0.02 0.03; with -min_delay 5 -default_delay 20: 0 0.01 0.02 0.03' ]
