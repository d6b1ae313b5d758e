#!/usr/bin/env bash
# Package: pycolmap 4.2.1 (PyPI), on a valid model in COLMAP 4's text form: cameras, rigs, frames, images.
# Behaviour: the pose in images.txt is ignored where rigs.txt and frames.txt are not empty. An image whose line has another pose than its rig and frame is read
#   without a message, and `cam_from_world()` is the composed pose; with empty rigs.txt and frames.txt the line counts.
# Guess beforehand: an error or a warning that names the image, or the image's own pose, as in every version before 3.12.
# Output seen:
#   with rigs and frames: 3.0
#   without: 9.0
# Consequence: a tool that moves cameras by editing only images.txt moves nothing. It must edit frames.txt, or empty both files.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 pycolmap==4.2.1
mkdir "$folder/model"
cd "$folder/model"
echo '1 PINHOLE 64 48 50 50 32 24' >cameras.txt
printf '1 1 0 0 0 0 0 9 1 a.png\n\n' >images.txt
echo '1 1 CAMERA 1' >rigs.txt
echo '1 1 1 0 0 0 0 0 3 1 CAMERA 1 1' >frames.txt
: >points3D.txt
depth() {
  "$folder/venv/bin/python" -c 'import pycolmap; print(pycolmap.Reconstruction(".").images[1].cam_from_world().translation[2])'
}
found="with rigs and frames: $(depth)"
: >rigs.txt
: >frames.txt
found+=$'\n'"without: $(depth)"
echo "$found"
[ "$found" = $'with rigs and frames: 3.0\nwithout: 9.0' ]
