"""The commands as a user types them, on clips of a few patches."""
import json

import cv2
import numpy as np
import pytest
import torch

from train import data, network
from train.__main__ import main


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    root, r = tmp_path_factory.mktemp('clips'), np.random.default_rng(5)
    for split, names in (('train', ('a', 'b')), ('val', ('c',))):
        for name in names:
            base = cv2.resize((r.random((12, 16, 3)) * 255).astype(np.uint8), (80, 60), interpolation=cv2.INTER_CUBIC)
            (root / split / name).mkdir(parents=True)
            for t in range(12):
                cv2.imwrite(str(root / split / name / f'{t:03}.png'), np.roll(base, t, 1)[:48, :64])
    return root


def whole(folder, run, out, *more):
    main(['all', '--clips', str(folder), '--run', str(run), '--out', str(out), '--resolution', '48', '64', '--steps', '3', '--gaps', '2', '6', '--middle', '2',
          '--intervals', '1', '--gaps-measured', '4', *more])


def test_one_command_makes_a_checkpoint_and_repeats_nothing_that_is_done(folder, tmp_path, capsys):
    run, out = tmp_path / 'run', tmp_path / 'small.safetensors'
    whole(folder, run, out, '--dtype', 'f32')
    net = network.open_official(out)
    assert net.config.resolution == (48, 64)
    measured = json.loads((run / 'eval.json').read_text())['gap4']
    figures = measured['mean']
    assert 0 < measured['widest_cells'] < 1e3
    assert {'key.ours', 'middle.ours', 'middle.crossfade', 'middle.nearest', 'middle.dis'} <= set(figures)
    capsys.readouterr()
    again = tmp_path / 'again.safetensors'
    whole(folder, run, again, '--dtype', 'f32', '--intervals', '-1')
    assert "'stage'" not in capsys.readouterr().out
    for k, v in net.state_dict().items():
        assert torch.equal(v, network.open_official(again).state_dict()[k]), k


def test_stages_one_by_one_give_what_the_single_command_gives(folder, tmp_path):
    whole(folder, tmp_path / 'run', tmp_path / 'a.safetensors', '--intervals', '-1')
    at = ['--clips', str(folder), '--run', str(tmp_path / 'parts')]
    main(['start', *at, '--resolution', '48', '64'])
    main(['static', *at, '--steps', '3', '--until', '2'])
    main(['static', *at, '--steps', '3'])
    main(['flow', *at, '--steps', '3', '--gaps', '2', '6', '--middle', '2'])
    main(['dynamic', *at, '--steps', '3', '--gaps', '2', '6', '--middle', '2'])
    main(['export', *at, '--out', str(tmp_path / 'b.safetensors')])
    assert (tmp_path / 'a.safetensors').read_bytes() == (tmp_path / 'b.safetensors').read_bytes()


def test_a_run_can_begin_with_an_exported_checkpoint(folder, tmp_path):
    at = ['--clips', str(folder), '--run']
    whole(folder, tmp_path / 'run', tmp_path / 'a.safetensors', '--intervals', '-1', '--dtype', 'f32')
    main(['start', *at, str(tmp_path / 'next'), '--from', str(tmp_path / 'a.safetensors')])
    main(['export', *at, str(tmp_path / 'next'), '--out', str(tmp_path / 'b.safetensors'), '--dtype', 'f32'])
    for kind in ('safetensors', 'json'):
        assert (tmp_path / f'a.{kind}').read_bytes() == (tmp_path / f'b.{kind}').read_bytes()


def test_order_says_what_depth_there_is_and_what_order_is_worth(folder, tmp_path):
    run = tmp_path / 'run'
    main(['start', '--clips', str(folder), '--run', str(run), '--resolution', '48', '64'])
    main(['order', '--clips', str(folder), '--run', str(run), '--scenes', '8', '--out', str(tmp_path / 'order.json')])
    got = json.loads((tmp_path / 'order.json').read_text())
    assert got['rendered']['pixels'] == 0.5 and got['rendered']['count'] == got['lower_is_nearer']['count'] > 0
    assert got['lower_is_nearer']['pixels'] != 0.5 and len(got['key_psnr_by_order']) == 6 and got['turned_by_10_degrees']['count'] > 0


def test_packed_clips_are_the_same_pictures_at_the_models_size(folder, tmp_path):
    main(['pack', '--clips', str(folder), '--out', str(tmp_path / 'packed'), '--size', '24', '32', '--limit-mb', '1'])
    for split, name in (('train', 'a'), ('val', 'c')):
        want, got = data.load_clip(folder / split / name, (24, 32)), data.load_clip(tmp_path / 'packed' / split / name, (24, 32))
        assert got.shape == want.shape and np.abs(got.astype(float) - want).mean() < 6
    assert sum(f.stat().st_size for f in (tmp_path / 'packed').rglob('*.jpg')) <= 1_000_000


def test_a_limit_that_cannot_be_kept_writes_nothing(folder, tmp_path):
    with pytest.raises(ValueError, match='allowed'):
        main(['pack', '--clips', str(folder), '--out', str(tmp_path / 'packed'), '--limit-mb', '0.001'])
    assert not (tmp_path / 'packed').exists()


def test_a_branch_that_adds_next_to_nothing_is_zeroed_and_no_other(folder, tmp_path):
    run = tmp_path / 'run'
    whole(folder, run, tmp_path / 'a.safetensors', '--intervals', '-1', '--dtype', 'f32')
    before = network.open_official(tmp_path / 'a.safetensors')
    sizes = {k: max(float(p.abs().max()) for p in m.parameters()) for k, m in before.named_modules() if k.endswith(('out_proj', 'c_proj'))}
    least = sorted(v for v in sizes.values() if v > 0)[1] * 1.0001          # the two smallest that are not zero
    main(['export', '--clips', str(folder), '--run', str(run), '--out', str(tmp_path / 'b.safetensors'), '--dtype', 'f32', '--zero-below', str(least)])
    after = network.open_official(tmp_path / 'b.safetensors')
    for k, v in after.state_dict().items():
        name = k.rsplit('.', 1)[0]
        want = torch.zeros_like(v) if sizes.get(name, least) < least else before.state_dict()[k]
        assert torch.equal(v, want), k
    assert sum(bool(after.state_dict()[k + '.weight'].any()) for k in sizes) == sum(v > 0 for v in sizes.values()) - 2
