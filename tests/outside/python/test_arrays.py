"""Gaussians in the world as arrays, still scenes, cameras, frames in memory: compared with the command line and the files that it writes."""

import json
import os
import pickle
import subprocess
import urllib.request
import warnings
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import streamsplat_cpu
from streamsplat_cpu import Camera, Scene, Splats

ROOT = Path(os.environ["STREAMSPLAT_ROOT"])
PROGRAM = os.environ["STREAMSPLAT"]
CLIP = ROOT / "fixtures/clips/moving.y4m"
Y0 = 0.28209479177387814


def program(*arguments):
    subprocess.run([PROGRAM, *map(str, arguments), "--quiet"], check=True)


@pytest.fixture(scope="session")
def video(tmp_path_factory):
    out = tmp_path_factory.mktemp("video") / "out"
    program("run", CLIP, "--gap", 4, "--frames", 9, "--out", out)
    return out


def values(count=300, degree=0, seed=7):
    """Arrays of a cloud around the origin."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(count, 4))
    arrays = {
        "means": rng.uniform(-1, 1, (count, 3)),
        "scales": rng.uniform(0.01, 0.2, (count, 3)),
        "opacities": rng.uniform(0.05, 0.95, count),
        "quats": quats / np.linalg.norm(quats, axis=1, keepdims=True),
    }
    arrays |= {"sh": rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3))} if degree else {"colors": rng.uniform(0, 1, (count, 3))}
    return {name: array.astype(np.float32) for name, array in arrays.items()}


@pytest.fixture(scope="session")
def garden(tmp_path_factory):
    path = tmp_path_factory.mktemp("garden") / "garden.ply"
    Splats(**values(degree=2)).save(path)
    return path


def columns(path):
    """The numbers of a binary PLY file of floats, by their names."""
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    names = [line.split()[-1].decode() for line in head.splitlines() if line.startswith(b"property float")]
    return dict(zip(names, np.frombuffer(body, "<f4").reshape(-1, len(names)).T))


def test_arrays_are_the_numbers_of_the_exported_file(video, tmp_path):
    scene = Scene(video)
    time = 0.5 * sum(scene.times[1])
    splats = scene.at(time)
    program("export", video, "--format", "ply", "--times", time, "--out", tmp_path / "out")
    (exported,) = (tmp_path / "out").glob("*.ply")
    file = columns(exported)
    stack = lambda *names: np.stack([file[name] for name in names], axis=1)
    assert np.array_equal(splats.means, stack("x", "y", "z")) and len(splats) > 10_000
    assert np.array_equal(splats.sh[:, 0], stack("f_dc_0", "f_dc_1", "f_dc_2")) and splats.sh.shape == (len(splats), 1, 3)
    np.testing.assert_allclose(splats.scales, np.exp(stack("scale_0", "scale_1", "scale_2").astype(float)), rtol=1e-6)
    np.testing.assert_allclose(splats.opacities, 1 / (1 + np.exp(-file["opacity"].astype(float))), rtol=1e-6)
    np.testing.assert_allclose(splats.colors, 0.5 + Y0 * splats.sh[:, 0].astype(float), atol=1e-7)
    assert np.array_equal(splats.quats, np.tile(np.float32([1, 0, 0, 0]), (len(splats), 1)))
    # The opened file has the arrays, bit for bit, and so has the interval.
    for other in (Scene(exported).at(), scene.interval(time).at(time)):
        for name in ("means", "quats", "scales", "opacities", "colors", "sh"):
            assert np.array_equal(getattr(other, name), getattr(splats, name)), name
    splats.save(tmp_path / "again.ply")
    scene.interval(time).save(tmp_path / "interval.ply", time)
    assert (tmp_path / "again.ply").read_bytes() == exported.read_bytes() == (tmp_path / "interval.ply").read_bytes()


def test_identities_last_and_arrays_are_float32_and_read_only(video):
    scene = Scene(video)
    interval = scene[1]
    splats = interval.at(interval.end)
    assert splats.identities.dtype == np.uint64 and np.isin(splats.identities, interval.gaussians.identity).all()
    assert len(np.unique(splats.identities)) == len(splats)
    assert np.isin(interval.at(interval.start).identities, splats.identities).mean() > 0.5
    for name, shape in {"means": (3,), "quats": (4,), "scales": (3,), "opacities": (), "colors": (3,), "sh": (1, 3)}.items():
        array = getattr(splats, name)
        assert array.dtype == np.float32 and array.shape == (len(splats), *shape) and np.isfinite(array).all(), name
        assert np.shares_memory(array, getattr(splats, name)), name
        with pytest.raises(ValueError):
            array[0] = 0
    assert splats.drawable.all() and splats.offset == (0, 0, 0)
    # The world of docs/cameras.md: half of the picture's height is 1, depths are from 0.1 to 5 half widths.
    aspect = 256 / 144
    assert 0.0999 * aspect <= splats.means[:, 2].min() and splats.means[:, 2].max() <= 5.001 * aspect
    assert 0.8 < np.abs(splats.means[:, 1]).max() < 1.3 < np.abs(splats.means[:, 0]).max() < 2.3
    # They outlive their source, and fit the standard of arrays in memory.
    means = Scene(video).at(0.0).means
    assert np.isfinite(np.from_dlpack(means)).all() and np.shares_memory(np.from_dlpack(means), means)


def test_every_format_opens_as_a_still_scene(garden, tmp_path):
    first = Scene(garden)
    expected = first.at()
    assert first.is_still and len(first) == 0 and first and first.times == []
    assert expected.sh_degree == 2 and expected.sh.shape == (300, 9, 3)
    for ending in ("ply", "compressed.ply", "spz", "sog", "glb", "splat"):
        path = tmp_path / f"garden.{ending}"
        with warnings.catch_warnings():
            # Notes on precision, which other tests cover.
            warnings.simplefilter("ignore")
            expected.save(path)
            scene = Scene(path)
        splats = scene.at()
        assert len(splats) == 300 and splats.sh_degree == (0 if ending == "splat" else 2), ending
        assert np.array_equal(Splats.of_bytes(path.read_bytes(), path.name).means, splats.means), ending
        assert f"{len(splats)} Gaussians" in repr(scene) and str(path) in repr(scene)
        if ending in ("ply", "glb"):
            assert np.array_equal(splats.means, expected.means) and np.array_equal(splats.sh, expected.sh), ending
        program("render", path, "--out", tmp_path / f"{ending}.png", "--size", "64x36")
        assert scene.render(size="64x36").png() == (tmp_path / f"{ending}.png").read_bytes(), ending
    with pytest.raises(streamsplat_cpu.Error, match="scene in memory: expected a still scene"):
        Splats.of_bytes(b"hello")


def test_images_are_those_of_the_command_line(garden, video, tmp_path):
    scene = Scene(garden)
    program("render", garden, "--out", tmp_path / "own.png")
    own = scene.render()
    assert (own.width, own.height) == (1280, 720) and own.png() == (tmp_path / "own.png").read_bytes() == scene.at().render().png()
    matrix = np.diag([1.0, -1, -1, 1])
    matrix[2, 3] = -3
    frames = []
    for i in range(9):
        matrix[0, 3] = 0.1 * i
        frames.append({"file_path": f"{i}.png", "transform_matrix": matrix.tolist()})
    lens = {"w": 96, "h": 54, "fl_x": 90, "fl_y": 88, "cx": 46, "cy": 27}
    (tmp_path / "transforms.json").write_text(json.dumps(lens | {"frames": frames}))
    cameras = streamsplat_cpu.cameras(tmp_path / "transforms.json")
    assert [camera.name for camera in cameras] == [f"{i}.png" for i in range(9)] and cameras[0].size == (96, 54)
    program("render", garden, "--camera", tmp_path / "transforms.json", "--out", tmp_path / "views")
    files = [path.read_bytes() for path in sorted((tmp_path / "views/frames").iterdir())]
    assert [image.png() for image in scene.render(cameras)] == files == [scene.render(camera).png() for camera in cameras]
    # gsplat's matrices are the same cameras.
    for camera, image in zip(cameras, scene.render(cameras)):
        np.testing.assert_allclose(camera.K, [[90, 0, 46], [0, 88, 27], [0, 0, 1]], atol=1e-5)
        again = Camera(camera.viewmat, camera.K, 96, 54)
        assert np.abs(scene.render(again).rgb - image.rgb).max() < 1e-3
        # Rows of the matrix are its axes: right, down, front.
        np.testing.assert_allclose(camera.viewmat[:3] @ np.append(camera.position, 1), 0, atol=1e-6)
    np.testing.assert_allclose(cameras[3].viewmat, [[1, 0, 0, -0.3], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-6)
    # Another size, a dictionary, a path, planes, a background.
    assert scene.render(cameras[0], size="48x27").rgb.shape == (27, 48, 3) == scene.render(cameras[0].resized(48, 27)).rgb.shape
    own_json = {"type": "pinhole", "position": [0, 0, -3], "fov_y_degrees": 40, "aspect": 16 / 9}
    (tmp_path / "camera.json").write_text(json.dumps(own_json))
    program("render", garden, "--camera", tmp_path / "camera.json", "--size", "64x36", "--background", "0", "--out", tmp_path / "a.exr")
    image = scene.render(own_json, size=(64, 36), background=0.0, depth=True, alpha=True)
    image.save(tmp_path / "b.exr")
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    assert scene.render(tmp_path / "camera.json", size="64x36").png() == scene.render(own_json, size="64x36").png()
    with pytest.raises(ValueError, match="found the 9 of .*: render\\(cameras\\("):
        scene.render(tmp_path / "transforms.json")
    # One camera shows a scene in time and its file in the same way.
    moving = Scene(video)
    program("render", video, "--times", 0.1, "--camera", tmp_path / "camera.json", "--size", "64x36", "--out", tmp_path / "c.png")
    assert moving.render(0.1, own_json, size="64x36").png() == (tmp_path / "c.png").read_bytes()
    near = np.abs(moving.at(0.1).render(own_json, size="512x288").rgb - moving.render(0.1, own_json, size="512x288").rgb)
    assert near.mean() < 0.01


def test_cameras_of_every_reader(garden, tmp_path):
    model = tmp_path / "project/sparse/0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("1 PINHOLE 64 36 60 60 32 18\n")
    (model / "images.txt").write_text("1 1 0 0 0 0 0 3 1 IMG_0042.jpg\n\n")
    inria = [{"img_name": "a", "width": 64, "height": 36, "fx": 60, "fy": 60, "position": [0, 0, -3], "rotation": np.eye(3).tolist()}]
    (tmp_path / "cameras.json").write_text(json.dumps(inria))
    turned = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, -3], [0, 0, 0, 1]]
    flight = {"render_width": 64, "render_height": 36, "fps": 2, "camera_path": [{"camera_to_world": sum(turned, []), "fov": 33.4}] * 2}
    (tmp_path / "camera_path.json").write_text(json.dumps(flight))
    settings = {"camera": {"fov": 50, "position": [0, 0, -3], "target": [0, 0, 0]}}
    (tmp_path / "settings.json").write_text(json.dumps(settings))
    path = {"views": [{"time": t, "type": "orthographic", "position": [0, 0, -3 - t]} for t in (0, 2)]}
    (tmp_path / "path.json").write_text(json.dumps(path))
    found = {}
    for name in ("project", "cameras.json", "camera_path.json", "settings.json", "path.json"):
        found[name] = streamsplat_cpu.cameras(tmp_path / name, size="64x36")
        assert all(camera.size == (64, 36) for camera in found[name]), name
    assert [len(cameras) for cameras in found.values()] == [1, 1, 2, 1, 2]
    colmap, original = found["project"][0], found["cameras.json"][0]
    assert (colmap.name, original.name) == ("IMG_0042.jpg", "a")
    assert np.array_equal(colmap.viewmat, original.viewmat) and np.array_equal(colmap.K, original.K)
    assert [camera.time for camera in found["camera_path.json"]] == [0, 0.5] and [camera.time for camera in found["path.json"]] == [0, 2]
    assert found["path.json"][0].kind == "orthographic" and found["settings.json"][0].kind == "pinhole"
    scene = Scene(garden)
    assert scene.render(colmap).png() == scene.render(original).png() == scene.render(tmp_path / "cameras.json").png()


def test_cameras_look_and_go_around(garden, tmp_path):
    splats = Scene(garden).at()
    camera = Camera.look_at((0, 0, -3), (0, 0, 0), fov_y=40, width=64, height=36)
    assert camera.position == (0, 0, -3) and camera.size == (64, 36)
    same = {"type": "pinhole", "position": [0, 0, -3], "look_at": [0, 0, 0], "fov_y_degrees": 40, "aspect": 64 / 36}
    assert splats.render(camera).png() == splats.render(same, size="64x36").png()
    around = splats.orbit(8, size="64x36")
    program("render", garden, "--turntable", "1", "--fps", "8", "--size", "64x36", "--out", tmp_path / "around")
    files = [path.read_bytes() for path in sorted((tmp_path / "around/frames").iterdir())]
    assert [image.png() for image in splats.render(around)] == files and len(files) == 8
    assert splats.render(splats.camera(90, size="64x36")).png() != splats.render(splats.camera(0, size="64x36")).png()
    assert repr(around[0]).startswith("Camera(pinhole at (") and repr(around[0]).endswith("64×36)")


def test_an_empty_picture_warns(garden):
    scene = Scene(garden)
    K = [[300, 0, 64], [0, 300, 48], [0, 0, 1]]
    away = np.eye(4)
    away[2, 3] = -9  # the scene is behind the camera
    with pytest.warns(UserWarning, match="nothing drawn: the camera sees none of 300 Gaussians"):
        scene.render(Camera(away, K, 128, 96))
    away[2, 3] = 9
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.render(Camera(away, K, 128, 96))
    with pytest.raises(TypeError, match=r"a matrix is Camera\(viewmat, K, width, height\)"):
        scene.render(away)


def test_arrays_become_a_scene_that_is_drawn_saved_and_pickled(tmp_path):
    arrays = values()
    splats = Splats(**arrays)
    for name, array in arrays.items():
        np.testing.assert_allclose(getattr(splats, name), array, rtol=2e-6, atol=2e-7, err_msg=name)
    assert np.array_equal(splats.identities, np.arange(300)) and repr(splats).startswith("Splats(300 Gaussians, sh_degree=0, most of it from (")
    assert (np.abs(np.linalg.norm(splats.quats, axis=1) - 1) < 1e-6).all()
    twice = Splats(**arrays | {"quats": 2 * arrays["quats"]})
    np.testing.assert_allclose(twice.quats, splats.quats, atol=1e-7)
    w, x, y, z = splats.quats.astype(float).T
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]).transpose(2, 0, 1)
    expected = turn @ (splats.scales.astype(float)[:, :, None] ** 2 * turn.transpose(0, 2, 1))
    np.testing.assert_allclose(splats.covariances, expected, atol=1e-7)
    # Numbers of any kind, lists, unaligned and strided arrays.
    kinds = {name: array.astype(np.float64)[::-1][::-1] for name, array in arrays.items()}
    assert Splats(**kinds).render(size="64x36").png() == splats.render(size="64x36").png()
    assert Splats(**{name: array.tolist() for name, array in arrays.items()}).render(size="64x36").png() == splats.render(size="64x36").png()
    again = pickle.loads(pickle.dumps(splats))
    assert again.render(size="64x36").png() == splats.render(size="64x36").png()
    high = values(degree=3)
    assert np.array_equal(Splats(**high).sh, high["sh"]) and Splats(**high).sh_degree == 3
    # An image from another side has other colours.
    red = {**values(1), "sh": np.zeros((1, 4, 3), np.float32), "means": np.zeros((1, 3), np.float32)}
    red["sh"][0, 3, 0], red["opacities"][0], red["scales"][0] = 1.0, 0.99, 1.0
    del red["colors"]
    left, right = (Splats(**red).render(Camera.look_at((x, 0, 0), (0, 0, 0), width=8, height=8)).rgb[4, 4, 0] for x in (-5, 5))
    assert abs(left - right) > 0.5
    for name in ("identities",):
        assert getattr(again, name).tolist() == getattr(splats, name).tolist()


def test_arrays_that_do_not_fit_are_refused_in_a_sentence(garden):
    def refused(kind, text, **changes):
        arrays = values(degree=changes.pop("degree", 0)) | changes
        with pytest.raises(kind, match=text):
            Splats(**{name: array for name, array in arrays.items() if array is not None})

    nan = values()["means"].copy()
    nan[7, 1] = np.nan
    refused(ValueError, r"means: expected finite numbers, found NaN at Gaussian 7", means=nan)
    refused(ValueError, r"means: expected an array \[N, 3\], found the shape \[300\]", means=nan[:, 0])
    refused(ValueError, r"means: expected an array \[N, 3\], found the shape \[300, 2\]", means=nan[:, :2])
    refused(ValueError, r"means: expected at least one Gaussian, found none", means=np.zeros((0, 3)))
    refused(ValueError, r"scales: expected 300 rows for 300 Gaussians, found 299", scales=values()["scales"][1:])
    refused(ValueError, r"scales: expected finite numbers from 0 on, found -1 at Gaussian 0", scales=-np.ones((300, 3)))
    refused(ValueError, r"opacities: expected numbers from 0 to 1, found 2 at Gaussian 0", opacities=np.full(300, 2.0))
    refused(ValueError, r"opacities: expected an array \[N\]", opacities=np.full((300, 1), 0.5))
    refused(ValueError, r"quats: expected quaternions other than 0, found 0 at Gaussian 0", quats=np.zeros((300, 4)))
    refused(ValueError, r"colors: expected 300 rows", colors=np.zeros((1, 3)))
    refused(ValueError, r"colors, sh: expected one of the two, found neither", colors=None)
    refused(ValueError, r"colors, sh: expected one of the two, found both", sh=np.zeros((300, 1, 3)))
    refused(ValueError, r"sh: expected an array \[N, K, 3\] with K of 1, 4, 9 or 16", degree=1, sh=np.zeros((300, 5, 3)))
    refused(TypeError, r"means: expected numbers, found <U1", means=np.full((300, 3), "a"))
    many = np.broadcast_to(np.float32(0), (2**24 + 1, 3))
    one = np.broadcast_to(np.float32(0.5), (2**24 + 1,))
    with pytest.raises(ValueError, match=r"means: expected at most 16777216 Gaussians, found 16777217"):
        Splats(many, many, one, colors=many)
    K = [[60, 0, 32], [0, 60, 18], [0, 0, 1]]
    for kind, text, call in [
        (ValueError, r"viewmat: expected a matrix \[4, 4\], found the shape \(3, 3\)", lambda: Camera(np.eye(3), K, 64, 36)),
        (ValueError, r"viewmat: expected a rotation \(orthonormal, right-handed\)", lambda: Camera(np.diag([1, 1, 0, 1]), K, 64, 36)),
        (ValueError, r"viewmat: expected a rotation", lambda: Camera(np.diag([1, 1, -1, 1]), K, 64, 36)),
        (ValueError, r"viewmat: expected finite numbers, found NaN", lambda: Camera(np.full((4, 4), np.nan), K, 64, 36)),
        (ValueError, r"K: expected focal lengths above 0, found 0 and 60", lambda: Camera(np.eye(4), [[0, 0, 1], [0, 60, 1], [0, 0, 1]], 64, 36)),
        (ValueError, r"K: expected \[\[fx, 0, cx\]", lambda: Camera(np.eye(4), [[60, 1, 1], [0, 60, 1], [0, 0, 1]], 64, 36)),
        (ValueError, r"width, height: expected .* found 0×36", lambda: Camera(np.eye(4), K, 0, 36)),
        (ValueError, r"target: expected a point apart", lambda: Camera.look_at((0, 0, 0), (0, 0, 0))),
        (ValueError, r"fov_y: expected degrees between 0 and 180, found 180", lambda: Camera.look_at((0, 0, 0), (0, 0, 1), fov_y=180)),
        (TypeError, r"found a still one \(PLY\): at\(\) and render\(camera\) take no time", lambda: Scene(garden)[0]),
        (TypeError, r"found a still one", lambda: Scene(garden).fps),
        (ValueError, r"size: expected WIDTHxHEIGHT, found source", lambda: Scene(garden).render(size="source")),
        (ValueError, r"canonical", lambda: Scene(garden).render({"type": "canonical"})),
        (ValueError, r"size: expected 'WIDTHxHEIGHT'", lambda: streamsplat_cpu.cameras(garden, size="model")),
        (ValueError, r"garden.ply", lambda: streamsplat_cpu.cameras(garden)),
        (TypeError, r"camera: expected a Camera", lambda: Scene(garden).render([Camera.look_at((0, 0, 0), (0, 0, 1)), 7])),
        (ValueError, r"expected a name ending in .ply", lambda: Scene(garden).at().save("a.obj")),
    ]:
        with pytest.raises(kind, match=text):
            call()


def test_a_scene_in_time_needs_a_time(video):
    scene = Scene(video)
    for call in (scene.at, scene.render, lambda: scene.render({"type": "orthographic"})):
        with pytest.raises(TypeError, match="time: expected seconds from 0 to 0.3"):
            call()
    with pytest.raises(streamsplat_cpu.Error, match="expected one between"):
        scene.at(9.0)


def test_gaussians_of_a_file_that_change_in_time(tmp_path):
    own = ["trbf_center", "trbf_scale", *(f"motion_{k}" for k in range(9)), *(f"omega_{k}" for k in range(4))]
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split() + own
    row = "0 0 0 1 0.5 0 3 -2 -2 -2 1 0 0 0 0.5 0 1 " + "0 " * (len(names) - 17)
    header = "".join(f"property float {name}\n" for name in names)
    (tmp_path / "flames.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{header}end_header\n{row}\n")
    with pytest.warns(UserWarning):
        scene = Scene(tmp_path / "flames.ply")
    assert scene.at(1.0).means[0, 0] - scene.at().means[0, 0] == 1.0
    camera = Camera.look_at((0, 0, -3), (0, 0, 0), width=64, height=36)
    first, last = scene.render([0.0, 1.0], [camera, camera])
    assert first.png() == scene.render(camera).png() != last.png() == scene.render(1.0, camera).png()


def test_frames_in_memory_become_what_their_file_becomes(tmp_path):
    def files(folder):
        records = ("run.json", "report.md")
        return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file() and p.name not in records}

    options = {"gap": 4, "refine": 0}
    streamsplat_cpu.reconstruct(CLIP, tmp_path / "file", frames=9, **options)
    frames = list(streamsplat_cpu.Frames(CLIP))
    seen = []
    result = streamsplat_cpu.reconstruct(streamsplat_cpu.Frames(CLIP), tmp_path / "video", frames=9, progress=lambda *step: seen.append(step), **options)
    assert files(tmp_path / "video") == files(tmp_path / "file") and len(files(tmp_path / "file")) > 10
    assert result.frames == 9 and result.record["input"]["path"] == "<memory>" and seen[-1] == (9, 9)
    streamsplat_cpu.reconstruct((frame for frame, _ in frames[:9]), tmp_path / "arrays", fps=24, **options)
    assert files(tmp_path / "arrays") == files(tmp_path / "file")
    # Times of frames that no constant rate has.
    uneven = [(frame, time**1.5) for frame, time in frames[:9]]
    streamsplat_cpu.reconstruct(uneven, tmp_path / "uneven", **options)
    assert Scene(tmp_path / "uneven").times[-1][1] == frames[8][1] ** 1.5
    # An error during the run is the caller's own exception.
    def broken():
        yield frames[0]
        raise KeyError("camera")

    for kind, text, given in [
        (KeyError, "camera", broken()),
        (TypeError, "frame: expected an array", [[1, 2, 3]]),
        (TypeError, "pairs of a frame and its time", [(frames[0][0], 0.0, 1)]),
        (streamsplat_cpu.Error, "expected finite times that ascend, found 0, after 0", [(frames[0][0], 0.0)] * 2),
        (streamsplat_cpu.Error, "<memory>: the frame is 2×2, expected 256×144", [frames[0][0], np.zeros((2, 2, 3), np.uint8)]),
        (TypeError, "not iterable", 7),
    ]:
        with pytest.raises(kind, match=text):
            streamsplat_cpu.reconstruct(given, tmp_path / "broken", **options, overwrite=True)
    verified = subprocess.run([PROGRAM, "verify", tmp_path / "video"], capture_output=True, text=True)
    assert verified.returncode == 1 and "memory, which cannot be read again" in verified.stderr


def test_frames_of_every_usual_kind_are_taken(tmp_path):
    pixels = np.random.default_rng(3).integers(0, 256, (36, 64, 4), dtype=np.uint8)
    PIL.Image.fromarray(pixels).save(tmp_path / "alpha.png")
    grey = pixels[..., 0]
    PIL.Image.fromarray(grey).save(tmp_path / "grey.png")
    draw = lambda frame: streamsplat_cpu.Engine(threads=1).push(frame, 0.0).render(0.0).png()
    of_file = lambda name: draw(next(iter(streamsplat_cpu.Frames(tmp_path / name)))[0])
    assert draw(pixels) == draw(PIL.Image.fromarray(pixels)) == of_file("alpha.png")
    assert draw(grey) == draw(grey[..., None]) == draw(PIL.Image.fromarray(grey)) == of_file("grey.png") == draw(np.stack([grey] * 3, -1))
    opaque = pixels[..., :3]
    assert draw(opaque) == draw(opaque / np.float32(255)) == draw((opaque / np.float32(255)).astype(np.float64))
    assert draw(PIL.Image.fromarray(opaque)) == draw(opaque)
    palette = PIL.Image.fromarray(opaque).quantize(8)
    assert draw(palette) == draw(palette.convert("RGB"))


def test_scenes_and_intervals_show_themselves_in_a_notebook(video, garden, tmp_path):
    scene = Scene(video)
    for shown, size in ((scene, (256, 144)), (scene[1], (256, 144)), (Scene(garden), (640, 360)), (Scene(garden).at(), (640, 360))):
        (tmp_path / "shown.png").write_bytes(shown._repr_png_())
        assert PIL.Image.open(tmp_path / "shown.png").size == size
    image = scene.render(0.1, size="64x36", alpha=True)
    texts = [repr(x) for x in (scene, scene[1], scene[1].gaussians, image, streamsplat_cpu.Frames(CLIP), streamsplat_cpu.Engine(threads=1))]
    for text, parts in zip(texts, (["3 intervals", "24.000 frames a second", "256×144"], ["Interval(1: 0.000 s to 0.167 s", "Gaussians"], ["of interval 1"],
                                   ["Image(64×36, rgb, alpha)"], ["24 frames, 24.000 a second"], ["1 thread"])):
        assert all(part in text for part in parts), text


def test_images_are_saved_by_ending(garden, tmp_path):
    scene = Scene(garden)
    plain, planes = scene.render(size="64x36"), scene.render(size="64x36", depth=True, alpha=True)
    for ending in ("png", "webp"):
        program("render", garden, "--size", "64x36", "--out", tmp_path / f"expected.{ending}")
        plain.save(tmp_path / f"found.{ending}")
        assert (tmp_path / f"found.{ending}").read_bytes() == (tmp_path / f"expected.{ending}").read_bytes()
        assert np.array_equal(np.asarray(PIL.Image.open(tmp_path / f"found.{ending}").convert("RGB")), plain.rgb8())
    plain.save(tmp_path / "plain.exr")
    frame = next(iter(streamsplat_cpu.Frames(tmp_path / "plain.exr")))[0]
    assert np.array_equal(frame, plain.rgb)
    planes.save(tmp_path / "planes.exr")
    assert (tmp_path / "planes.exr").stat().st_size > (tmp_path / "plain.exr").stat().st_size
    assert plain.tobytes() == plain.rgb8().tobytes()


def test_the_page_is_served_until_it_is_closed(video, garden):
    for path, text in ((video, b'"intervals"'), (garden, b'"still"')):
        with Scene(path).view(open=False) as viewer:
            assert viewer.url.startswith("http://127.0.0.1:") and viewer.url in repr(viewer)
            assert b"<html" in urllib.request.urlopen(viewer.url, timeout=20).read()
            assert text in urllib.request.urlopen(viewer.url + "scene.json", timeout=20).read()
        with pytest.raises(OSError):
            urllib.request.urlopen(viewer.url, timeout=20)
        assert repr(viewer) == "Viewer(closed)"
        viewer.close()
    opened = Scene(garden).view(open=False)
    port = int(opened.url.rsplit(":", 1)[1].strip("/"))
    with pytest.raises(streamsplat_cpu.Error, match=str(port)):
        Scene(garden).view(port=port, open=False)
    opened.close()


def test_the_page_is_opened_in_the_browser(garden, monkeypatch):
    seen = []
    monkeypatch.setattr("webbrowser.open", seen.append)
    with Scene(garden).view() as viewer:
        assert seen == [viewer.url]
