import numpy as np

from train import data, depth


def test_a_batch_depends_on_seed_and_step_alone(clips):
    a, b = data.Pairs(clips, 5, 2, gaps=(2, 6)), data.Pairs(clips, 5, 2, gaps=(2, 6))
    a.batch(0)
    x, y = a.batch(7), b.batch(7)
    assert all(np.array_equal(x[k], y[k]) for k in x)
    assert not np.array_equal(x['rgb'], a.batch(8)['rgb'])
    assert np.array_equal(data.Frames(clips, 1, 2, (4, 8)).batch(3)[0], data.Frames(clips, 1, 2, (4, 8)).batch(3)[0])


def test_a_procedural_scene_moves_as_it_says(clips):
    """Warping the second frame by the stated motion yields the first one, where nothing is hidden."""
    pairs = data.Pairs(clips, 0, 1, procedural=1.0, gaps=(2, 6))
    better = []
    for i in range(12):
        s = pairs.scene(np.random.default_rng(i))
        a, b, f, g = s['rgb'][0], s['rgb'][1], s['flow'][0], s['flow'][1]
        seen = data.consistent(f, g) > 0
        seen &= (np.abs(np.mgrid[0:48, 0:64][0] + f[..., 1] - 23.5) < 22) & (np.abs(np.mgrid[0:48, 0:64][1] + f[..., 0] - 31.5) < 30)
        if seen.sum() < 200 or np.abs(f).max() < 0.5:
            continue
        better.append(np.abs(data.warp(b, f) - a)[seen].mean() / (np.abs(b - a)[seen].mean() + 1e-6))
    assert len(better) >= 5 and np.median(better) < 0.5


def test_nearer_layers_have_larger_inverse_depth(clips):
    pairs = data.Pairs(clips, 0, 1, gaps=(2, 6))
    for i in range(20):
        s = pairs.scene(np.random.default_rng(i))
        front = s['foreground'][0] > 0.99
        if front.any() and (~front).any():
            assert s['depth'][0][front].min() >= s['depth'][0][s['foreground'][0] < 0.01].max()


def test_both_directions_and_all_gaps_occur(clips):
    pairs = data.Pairs(clips, 0, 1, procedural=0.0, gaps=(2, 6))
    times = np.concatenate([pairs.real(np.random.default_rng(i))['time'][2:] for i in range(60)])
    assert times.min() > 0 and times.max() < 1 and len(set(np.round(times, 3))) > 6


def test_a_scene_from_where_it_is_seen_is_the_scene_and_a_plane_from_the_side_is_squeezed(clips):
    source, planes = data.Pairs(clips, 0, 1, middle=1), 0
    for k in range(12):
        s = source.scene(np.random.default_rng(k), (0.0, 10.0))
        np.testing.assert_allclose(s['turned'][:, 0], s['rgb'][:2], atol=1e-5)
        assert s['both'][:, 0].all() and s['both'][:, 1].mean() > 0.5
        if not s['foreground'].any():
            planes += 1
            got = np.stack([depth.turned_on_its_plane(image, 10.0) for image in s['rgb'][:2]])
            assert np.abs(got - s['turned'][:, 1])[s['both'][:, 1] > 0].mean() < 0.02
        else:                                          # surfaces hidden from here and visible from there do not count
            assert (s['both'][:, 1, :, 2:-2] == 0).any() or not (s['foreground'][:2] > 0.99).any()
    assert planes


def test_a_magnified_part_is_softer_and_what_is_not_magnified_stays_as_it_is(clips):
    plain, all_of_it = (data.Frames(clips, 1, 8, magnified=share).batch(3)[0] for share in (0.0, 1.0))
    assert plain.shape == all_of_it.shape
    fine = lambda x: np.abs(np.diff(x, axis=-1)).mean()
    assert fine(all_of_it) < 0.9 * fine(plain)
    r = np.random.default_rng(0)
    flat = data.magnify(r, np.full((48, 64, 3), 77, np.uint8))
    assert flat.shape == (48, 64, 3) and (flat == 77).all()
