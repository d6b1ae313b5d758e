"""check.py STREAMSPLAT: models written by pycolmap, drawn through this program's reader and by pycolmap's own poses."""

import json
import pathlib
import re
import struct
import subprocess
import sys
import tempfile

import numpy as np
import pycolmap

PROGRAM = sys.argv[1]
WIDTH, HEIGHT, FOCAL = 96, 64, 80.0
RANDOM = np.random.default_rng(7)


def run(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([PROGRAM, *map(str, words)], capture_output=True, text=True)


def passes(*words: object) -> None:
    found = run(*words)
    assert found.returncode == 0, f"{words}: {found.stderr}"


def fails(*words: object) -> str:
    found = run(*words)
    assert found.returncode == 1, f"{words}: {found.returncode}"
    return found.stderr


def cloud(path: pathlib.Path) -> None:
    """300 Gaussians around the origin."""
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
    values = RANDOM.normal(size=(300, len(names)))
    values[:, 6] += 2.0
    values[:, 7:10] = -2.0 + 0.3 * values[:, 7:10]
    header = "".join(f"property float {name}\n" for name in names)
    text = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(values)}\n{header}end_header\n"
    path.write_bytes(text.encode() + values.astype("<f4").tobytes())


def rigid(around: float, far: float) -> pycolmap.Rigid3d:
    """A rotation about an axis near y, and a translation along z."""
    axis = np.array([0.1, 1.0, 0.2]) / np.linalg.norm([0.1, 1.0, 0.2])
    x, y, z = axis * np.sin(around / 2)
    return pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([x, y, z, np.cos(around / 2)])), np.array([0.1, -0.2, far]))


def model(folder: pathlib.Path) -> pycolmap.Reconstruction:
    """A rig of two cameras at three times, in COLMAP's text form, read by pycolmap."""
    folder.mkdir()
    quaternion = lambda pose: " ".join(repr(float(c)) for c in [pose.rotation.quat[3], *pose.rotation.quat[:3], *pose.translation])
    lens = f"{WIDTH} {HEIGHT} {FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2}"
    (folder / "cameras.txt").write_text(f"1 PINHOLE {lens}\n2 PINHOLE {lens}\n")
    (folder / "rigs.txt").write_text(f"1 2 CAMERA 1 CAMERA 2 1 {quaternion(rigid(0.3, 0.4))}\n")
    frames, images = [], []
    for moment in range(3):
        pose, first = rigid(0.5 * moment - 0.4, 5.0), 2 * moment + 1
        frames.append(f"{moment + 1} 1 {quaternion(pose)} 2 CAMERA 1 {first} CAMERA 2 {first + 1}\n")
        for camera in (1, 2):
            # Dummy poses: only those of the frames count.
            images.append(f"{first + camera - 1} 1 0 0 0 7 8 9 {camera} cam{camera}/{moment}.png\n\n")
    (folder / "frames.txt").write_text("".join(frames))
    (folder / "images.txt").write_text("".join(images))
    (folder / "points3D.txt").write_text("")
    return pycolmap.Reconstruction(folder)


def own(path: pathlib.Path, pose: pycolmap.Rigid3d) -> None:
    """Writes a camera of this program with pycolmap's pose."""
    matrix = np.eye(4)
    matrix[:3, :] = pose.inverse().matrix()
    focal = [FOCAL / WIDTH, FOCAL / HEIGHT]
    path.write_text(json.dumps({"type": "pinhole", "camera_to_world": matrix.tolist(), "focal": focal}))


def spoilt(source: pathlib.Path, target: pathlib.Path) -> None:
    """Writes the binary model with other poses in its images."""
    target.mkdir()
    for file in source.iterdir():
        (target / file.name).write_bytes(file.read_bytes())
    data, at = bytearray((target / "images.bin").read_bytes()), 8
    while at < len(data):
        struct.pack_into("<7d", data, at + 4, 1, 0, 0, 0, 7, 8, 9)
        at = data.index(b"\0", at + 64) + 1
        (points,) = struct.unpack_from("<Q", data, at)
        at += 8 + 24 * points
    (target / "images.bin").write_bytes(data)


def rigs_and_frames(scratch: pathlib.Path) -> None:
    scene = scratch / "scene.ply"
    cloud(scene)
    found = model(scratch / "text")
    (scratch / "binary").mkdir()
    found.write_binary(scratch / "binary")
    spoilt(scratch / "binary", scratch / "spoilt")
    poses = {image.name: image.cam_from_world() for image in pycolmap.Reconstruction(scratch / "spoilt").images.values()}
    assert all(np.allclose(poses[image.name].matrix(), image.cam_from_world().matrix()) for image in found.images.values())
    for name, pose in poses.items():
        expected = scratch / "own.png"
        own(scratch / "own.json", pose)
        passes("render", scene, "--camera", scratch / "own.json", "--size", f"{WIDTH}x{HEIGHT}", "-o", expected)
        for kind in ("text", "binary", "spoilt"):
            drawn = scratch / f"{kind}.png"
            passes("render", scene, "--camera", scratch / kind, "--view", name, "-o", drawn)
            passes("compare", expected, drawn, "--max-abs", 1)
            drawn.unlink()
        expected.unlink()
    print(f"{len(poses)} images of a rig: drawn with pycolmap's poses, as text, as binary, and with images that contradict them")


def camera_models(scratch: pathlib.Path) -> None:
    scene, count = scratch / "scene.ply", 0
    for name, model in pycolmap.CameraModelId.__members__.items():
        if name == "INVALID":
            continue
        count += 1
        camera = pycolmap.Camera.create_from_model_id(1, model, FOCAL, WIDTH, HEIGHT)
        for kind in ("bin", "txt"):
            folder = scratch / f"{name}-{kind}"
            (folder / "one").mkdir(parents=True)
            found = pycolmap.Reconstruction()
            found.add_camera_with_trivial_rig(camera)
            plain = pycolmap.Camera.create_from_model_id(2, pycolmap.CameraModelId.PINHOLE, FOCAL, WIDTH, HEIGHT)
            found.add_camera_with_trivial_rig(plain)
            for id, own_id in ((1, 1), (2, 2)):
                image = pycolmap.Image(name=f"{id}.png", camera_id=own_id, image_id=id)
                found.add_image_with_trivial_frame(image, rigid(0.1, 5.0))
            (found.write_binary if kind == "bin" else found.write_text)(folder / "one")
            passes("render", scene, "--camera", folder / "one", "--view", "2.png", "-o", folder / "2.png")
            words = ["render", scene, "--camera", folder / "one", "--view", "1.png", "-o", folder / "1.png"]
            if name in ("PINHOLE", "SIMPLE_PINHOLE"):
                passes(*words)
            else:
                text = fails(*words)
                assert re.search(rf"camera 1: expected SIMPLE_PINHOLE or PINHOLE .* found {name}$", text.strip()), text
    print(f"{count} camera models: told by name, as text and as binary")


with tempfile.TemporaryDirectory() as folder:
    rigs_and_frames(pathlib.Path(folder))
    camera_models(pathlib.Path(folder))
