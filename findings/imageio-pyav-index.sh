#!/usr/bin/env bash
# Package: imageio 2.38.1 with its plugin `pyav` (av 18.1.0, PyPI), on valid clips of 20 frames with a key frame every four: one of constant rate, one with
#   pauses before frames 5 and 12, and an MPEG-TS file, whose times begin at 1.4 s.
# Behaviour: `imread(path, plugin="pyav", index=k)` is the k-th frame only if frames have one rate and begin at time 0. The plugin seeks to the time k / rate,
#   and takes the time of the key frame found there for its number. After a pause and in MPEG-TS the frame is an earlier one; nothing is raised. Whether
#   the rate is constant is a flag of the container, and neither MP4 nor MPEG-TS has it set to varying. With `constant_framerate=False`, and by `imiter`,
#   all frames are right.
# Guess beforehand: the k-th frame, as `imiter` has it; a slower search where times vary.
# Valid by: the plugin's documentation of `read`: an integer is the index of the frame to read.
# Output seen (frames at index 3, 7, 13 and 18):
#   constant rate: 3 7 13 18; with constant_framerate=False: 3 7 13 18
#   with pauses: 3 7 13 8; with constant_framerate=False: 3 7 13 18
#   MPEG-TS: 0 0 0 4; with constant_framerate=False: 3 7 13 18
# Consequence: phones film at varying rates. Frames picked so, to compare them with drawn ones or to pass them on as arrays, are of other times.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 imageio==2.38.1 av==18.1.0 imageio-ffmpeg==0.8.1
ffmpeg=$(venv/bin/python -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())')
# Frame N has the luminance 16 + 10 N.
clip() {
  "$ffmpeg" -v error -f lavfi -i color=c=black:s=64x48:r=10:d=2 -vf "geq=lum='16+10*N':cb=128:cr=128,settb=1/1000,setpts='$1'" -fps_mode passthrough \
    -enc_time_base 1/1000 -c:v libx264 -qp 0 -bf 0 -g 4 "$2"
}
clip '100*N' constant.mp4
clip '100*N+if(gte(N,5),1000,0)+if(gte(N,12),700,0)' pause.mp4
"$ffmpeg" -v error -i constant.mp4 -c copy constant.ts
cat >try.py <<'END'
import imageio.v3 as iio


def number(frame):
    return round(float(frame.mean()) * 219 / 255 / 10)


for name, path in (('constant rate', 'constant.mp4'), ('with pauses', 'pause.mp4'), ('MPEG-TS', 'constant.ts')):
    assert [number(frame) for frame in iio.imiter(path, plugin='pyav')] == list(range(20))
    found = [' '.join(str(number(iio.imread(path, plugin='pyav', index=k, constant_framerate=constant))) for k in (3, 7, 13, 18)) for constant in (None, False)]
    print(f'{name}: {found[0]}; with constant_framerate=False: {found[1]}')
END
found=$(venv/bin/python try.py)
echo "$found"
[ "$found" = 'constant rate: 3 7 13 18; with constant_framerate=False: 3 7 13 18
with pauses: 3 7 13 8; with constant_framerate=False: 3 7 13 18
MPEG-TS: 0 0 0 4; with constant_framerate=False: 3 7 13 18' ]
