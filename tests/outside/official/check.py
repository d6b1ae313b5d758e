"""The authors' own modules against this program, on seeded weights.

usage: check.py STREAMSPLAT SOURCE WORK CLIP [--paper] [--flip]

STREAMSPLAT is the program, with `forward` of the crate streamsplat-tests in the same folder. SOURCE is the unpacked source of `streamsplat` 0.1.4 from PyPI,
WORK a folder for files, CLIP a small video. Every file of weights is written by the library of its format: torch.save, safetensors, timm and transformers.
--paper compares the network's tensors at the paper's size, and nothing else. --flip flips a bit of one weight in the network's files that the program reads:
then every comparison of the network must fail.
"""

import io
import json
import os
import pickle
import subprocess
import sys
import types
import warnings
import zipfile
from pathlib import Path

warnings.filterwarnings('ignore')
streamsplat, source, work = sys.argv[1], sys.argv[2], Path(sys.argv[3])
paper, flip = '--paper' in sys.argv, '--flip' in sys.argv
sys.path.insert(0, source)

import numpy as np
import torch
from PIL import Image
from safetensors.torch import load_file, save_file

torch.set_num_threads(2)
BAR = 3e-6  # relative error of a tensor, in the Euclidean norm

class Absent(types.ModuleType):
    """A package that does not affect the comparison; every call of it returns an empty module."""

    def __getattr__(self, name):
        if name.startswith('__'):
            raise AttributeError(name)
        return lambda *_, **__: torch.nn.Module()


# Packages that their files import: viewers, plots, measures of training.
for name in ('kiui', 'kiui.op', 'kiui.lpips', 'lpips', 'wandb', 'pdb', 'matplotlib', 'matplotlib.pyplot', 'seaborn', 'torchmetrics', 'torchmetrics.image', 'utils.metrics',
             'diff_gaussian_rasterization_kiui_orth'):
    sys.modules.setdefault(name, Absent(name))

failures = []


def check(true, text):
    if not true:
        failures.append(text)
        print('FAILED', text)


def relative(found, expected):
    found, expected = found.double().flatten(), expected.double().flatten()
    if found.shape != expected.shape:
        return float('inf')
    return float((found - expected).norm() / expected.norm().clamp_min(1e-30))


def forward(model, inputs, name):
    """The model's tensors for these inputs, by the tests' program `forward`."""
    save_file({k: v.contiguous() for k, v in inputs.items()}, work / f'{name}.in.safetensors')
    out = work / f'{name}.out.safetensors'
    subprocess.run([Path(streamsplat).with_name('forward'), model, work / f'{name}.in.safetensors', out], check=True)
    return load_file(out)


def compare(name, found, expected):
    for key, tensor in expected.items():
        error = relative(found[key], tensor)
        print(f'{name} {key}: {error:.1e}')
        check(error <= BAR, f'{name} {key}: expected a relative error of at most {BAR}, found {error}')


def seeded(module, seed):
    """Weights of a known spread in every parameter, also in those that start at zero."""
    generator = torch.Generator().manual_seed(seed)
    for key, parameter in module.named_parameters():
        fan = parameter.shape[1:].numel() if parameter.dim() > 1 else 1
        spread = (1.6 / fan**0.5) if parameter.dim() > 1 else 0.1
        parameter.data = torch.randn(parameter.shape, generator=generator) * spread
        if parameter.dim() == 1 and ('norm' in key or 'ln' in key or 'lambda' in key or 'gamma' in key) and not key.endswith('bias'):
            parameter.data += 1
    return module.eval()


# DINOv2 with four registers, written by three libraries.

WIDTH, DEPTH, HEADS = 128, 2, 2


def dino_official(width=WIDTH, depth=DEPTH, registers=4, heads=HEADS):
    from encoders.dinov2.models.vision_transformer import DinoVisionTransformer

    model = DinoVisionTransformer(img_size=518, patch_size=14, embed_dim=width, depth=depth, num_heads=heads, mlp_ratio=4, init_values=1.0, block_chunks=0,
                                  num_register_tokens=registers, interpolate_antialias=True, interpolate_offset=0.0, modulation_dim=None)
    return seeded(model, 1)


def dino_inputs(seed=2):
    generator = torch.Generator().manual_seed(seed)
    frame = torch.rand(1, 3, 96, 160, generator=generator)
    resized = torch.nn.functional.interpolate(frame, size=(252, 448), mode='bilinear', align_corners=False)
    return {'in.frame': frame}, resized


def official():
    model = dino_official()
    inputs, resized = dino_inputs()
    torch.save(model.state_dict(), work / 'official.pth')
    torch.save(model.half().state_dict(), work / 'official-half.pth')
    model = model.float()
    with torch.inference_mode():
        outs = model(resized, is_training=True)
    expected = {'out.patch_tokens': outs['x_norm_patchtokens'][0], 'out.cls_token': outs['x_norm_clstoken'][0]}
    compare('official-half.pth', forward(work / 'official-half.pth', inputs, 'official-half'), expected)
    # The same weights before they were rounded.
    model = dino_official()
    with torch.inference_mode():
        outs = model(resized, is_training=True)
    expected = {'out.patch_tokens': outs['x_norm_patchtokens'][0], 'out.cls_token': outs['x_norm_clstoken'][0]}
    compare('official.pth', forward(work / 'official.pth', inputs, 'official'), expected)
    # A flipped bit of one weight is detected.
    state = model.state_dict()
    flipped = {k: v.clone() for k, v in state.items()}
    flipped['blocks.0.attn.qkv.weight'].view(torch.int32)[0, 0] ^= 1 << 30
    torch.save(flipped, work / 'flipped.pth')
    found = forward(work / 'flipped.pth', inputs, 'flipped')
    check(relative(found['out.patch_tokens'], expected['out.patch_tokens']) > BAR, 'a flipped bit of a weight is not seen')


def of_timm():
    import timm
    from timm.models.vision_transformer import VisionTransformer

    reference = timm.create_model('vit_base_patch14_reg4_dinov2', pretrained=False).pretrained_cfg['architecture']
    check(reference == 'vit_base_patch14_reg4_dinov2', 'timm has no vit_base_patch14_reg4_dinov2')
    model = VisionTransformer(img_size=518, patch_size=14, embed_dim=WIDTH, depth=DEPTH, num_heads=HEADS, init_values=1e-5, reg_tokens=4, no_embed_class=True,
                              num_classes=0, dynamic_img_size=True, global_pool='token')
    seeded(model, 3)
    inputs, resized = dino_inputs()
    with torch.inference_mode():
        tokens = model.forward_features(resized)[0]
    expected = {'out.patch_tokens': tokens[5:], 'out.cls_token': tokens[:1]}
    save_file(model.state_dict(), work / 'timm.safetensors')
    torch.save(model.state_dict(), work / 'timm.bin')
    for file in ('timm.safetensors', 'timm.bin'):
        compare(file, forward(work / file, inputs, 'timm'), expected)


def of_transformers():
    from transformers import Dinov2WithRegistersConfig, Dinov2WithRegistersModel

    config = Dinov2WithRegistersConfig(hidden_size=WIDTH, num_hidden_layers=DEPTH, num_attention_heads=HEADS, num_register_tokens=4, image_size=518, patch_size=14)
    model = seeded(Dinov2WithRegistersModel(config), 4)
    inputs, resized = dino_inputs()
    with torch.inference_mode():
        tokens = model(resized).last_hidden_state[0]
    expected = {'out.patch_tokens': tokens[5:], 'out.cls_token': tokens[:1]}
    model.save_pretrained(work / 'transformers')
    torch.save(model.state_dict(), work / 'transformers.bin')
    for file in ('transformers/model.safetensors', 'transformers.bin'):
        compare(file, forward(work / file, inputs, 'transformers'), expected)


# The network itself.


def network(options, seed, use_dino):
    import model.model_utils as utils
    from model.model_utils import SplatPredictor

    # The authors' class downloads its weights; here it has seeded ones.
    utils.Dinov2Wrapper._build_dinov2 = staticmethod(lambda *_, **__: dino_official(768, 1, heads=12))
    predictor = SplatPredictor(options)
    out = predictor.gs_predictor.gaussian_upsampler.out_channels
    # 192 in their code is the width after upsampling at the published size.
    predictor.encoder_proj = torch.nn.Linear(out, out, bias=False)
    # Their condition is as wide as their tokens, 768 both; here tokens are narrower.
    decoder = predictor.decoder.transformer_decoder
    if use_dino and decoder.condition_proj.in_features != 768:
        decoder.condition_proj = torch.nn.Linear(768, decoder.condition_proj.out_features, bias=False)
    return seeded(predictor, seed)


def options(**changes):
    from configs.options_inference import Options

    return Options(**{'checkpointing': False, 'compile': False, **changes})


def options_of(config, **changes):
    height, width = config['resolution']
    return options(hidden_dim=config['hidden_dim'], decoder_hidden_dim=config['hidden_dim'], num_layers=config['encoder_layers'], decoder_num_layers=config['decoder_layers'],
                   image_height=height, image_width=width, down_resolution=(height, width), window_size=config['upsampler_window'], use_dino=config['use_dino'], **changes)


def one_bit_flipped(state, bit=22):
    """The weights with one bit of one of them, in the encoder's first layer, flipped."""
    state = {k: v.clone() for k, v in state.items()}
    key = next(k for k in state if 'encoder' in k and 'condition' not in k and k.endswith('mlp.c_fc.weight'))
    state[key].view(torch.int32)[0, 0] ^= 1 << bit
    return state


def write_network(file, predictor, config, flipped=False):
    """Writes the network's file as their training does, and the settings that shapes do not determine next to it."""
    state = {f'model.{k}': v.contiguous() for k, v in predictor.state_dict().items()}
    save_file(one_bit_flipped(state) if flipped or flip else state, file)
    file.with_suffix('.json').write_text(json.dumps({'config': config}))


def streamsplat_parity(name, seed, config, **changes):
    height, width = config['resolution']
    opt = options_of(config, **changes)
    predictor = network(opt, seed, config['use_dino'])
    generator = torch.Generator().manual_seed(seed + 1)
    frames = torch.rand(1, 2, 3, height, width, generator=generator)
    depths = torch.rand(1, 2, 1, height, width, generator=generator)
    with torch.inference_mode():
        h = torch.cat([predictor.forward_encoder(frames[:, i:i + 1], depths[:, i:i + 1]) for i in range(2)], 1)
        static = [predictor.gs_predictor.upsampling(h[:, i:i + 1]) for i in range(2)]
        heads = [predictor.gs_predictor.predictor(x)[0] for x in static]
        condition = predictor.forward_condition(frames, depths) if config['use_dino'] else h
        swapped = torch.cat([condition[:, 1:], condition[:, :1]], 2)
        decoded = predictor.decoder(torch.cat([h[:, :1], h[:, 1:]], 2), swapped)
        n = predictor.decoder.token_len
        d = torch.cat([decoded[:, :, :n], decoded[:, :, n:]], 1)
        dynamic = [predictor.upsampling(d[:, i:i + 1]) for i in range(2)]
        motion = [predictor.gs_dynamic_predictor(torch.cat([predictor.encoder_proj(s), x], -1))[0] for s, x in zip(static, dynamic)]
    both = lambda tensors: torch.stack([t.reshape(-1, t.shape[-1]) for t in tensors])
    expected = {
        'out.h': both([h[:, i] for i in range(2)]),
        'out.static_tokens': both(static),
        'out.static.xyz_static': both([g['xyz_static'] for g in heads]),
        'out.static.scale': both([g['scale'] for g in heads]),
        'out.static.opacity': both([g['opacity'] for g in heads]),
        'out.static.rgb': both([g['rgb'] for g in heads]),
        'out.d': both([d[:, i] for i in range(2)]),
        'out.dynamic_tokens': both(dynamic),
        'out.dynamic.velocity': both([m['xyz_dynamic'] for m in motion]),
        'out.dynamic.gamma': both([m['opacity_dynamic'] for m in motion]),
    }
    file = work / f'{name}.safetensors'
    write_network(file, predictor, config)
    inputs = {'in.frames': frames[0], 'in.depths': depths[0]}
    if config['use_dino']:
        inputs['in.condition'] = condition[0]
    compare(name, forward(file, inputs, name), expected)
    if config['use_dino']:
        torch.save(predictor.condition_encoder.model.state_dict(), work / f'{name}-dinov2.pth')


# A whole clip: from images and depth maps to the Gaussians that are passed to their rasteriser, and its image by its formulas.

GAP, FRAMES, RATE = 3, 10, 24
# Frames at which Gaussians are compared: between key frames, and two key frames at the ends of their intervals. Not the first one: there their script draws its
# pair at time 0, and this program draws only the first key frame, without waiting for the second.
COMPARED = (1, 3, 5, 7, 9)


class OnCpu(torch.overrides.TorchFunctionMode):
    """Keeps on the CPU what their code moves to a graphics card."""

    def __torch_function__(self, function, kinds, arguments=(), named=None):
        named = dict(named or {})
        if function is torch.Tensor.cuda:
            return arguments[0]
        if str(named.get('device', '')).startswith('cuda'):
            named['device'] = 'cpu'
        return function(*arguments, **named)


class Recorder:
    """Replaces their rasteriser, and keeps its arguments."""

    calls = []

    def __init__(self, raster_settings):
        self.settings = raster_settings

    def __call__(self, **handed):
        self.calls.append((self.settings, {k: v.clone() for k, v in handed.items() if v is not None}))
        size = (self.settings.image_height, self.settings.image_width)
        return torch.zeros(3, *size), torch.zeros(1), torch.zeros(1, *size), torch.zeros(1, *size)


def blocks(small, spread, generator):
    """An image twice as large, of whole numbers, whose bilinear reduction by 2 is `small` to the bit: opposite corners of a block differ by equal amounts."""
    change = torch.randint(0, spread + 1, small.shape, generator=generator)
    pattern = torch.tensor([[1, -1], [-1, 1]]).repeat(*small.shape)
    return torch.kron(small, torch.ones(2, 2, dtype=small.dtype)) + pattern * torch.kron(change, torch.ones(2, 2, dtype=change.dtype))


def make_clip(folder, height, width, seed):
    """Ten images and ten maps of inverse depth, of twice the size of the network's input. The largest depths are in maps of frames between key frames."""
    generator = torch.Generator().manual_seed(seed)
    (folder / 'frames').mkdir(parents=True)
    (folder / 'depth').mkdir()
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing='ij')
    frames, depths = [], []
    for k in range(FRAMES):
        inside = ((x - width // 3 - k).abs() < width // 6) & ((y - height // 2).abs() < height // 4)
        colours = [torch.where(inside, 200 - 40 * c, 30 + (x * (c + 1) + y * 2) % 150) for c in range(3)]
        noise = torch.randint(-8, 9, (3, height, width), generator=generator)
        small = (torch.stack(colours) + noise).clamp(20, 235)
        large = torch.stack([blocks(plane, 9, generator) for plane in small], -1)
        Image.fromarray(large.to(torch.uint8).numpy()).save(folder / 'frames' / f'{k:03}.png')
        depth = torch.where(inside, 30000, 5000 + 20 * x + 50 * y) + (0 if k % GAP == 0 else 20000)
        Image.fromarray(torch.kron(depth, torch.ones(2, 2, dtype=depth.dtype)).numpy().astype(np.uint16)).save(folder / 'depth' / f'{k:03}.png')
        frames.append(small.float())
        depths.append(depth.float())
    return frames, depths


def reduced(path, size):
    """An image's or a map's planes at the network's size, bilinear with half-pixel centres."""
    planes = torch.from_numpy(np.array(Image.open(path)).astype(np.float32))
    planes = planes.movedim(-1, 0) if planes.dim() == 3 else planes[None]
    return torch.nn.functional.interpolate(planes[None], size=size, mode='bilinear', align_corners=False)[0]


def gaussians_of_ply(path, aspect):
    """Position (world axes of their renderer), deviations, opacity and colour of a file of 3D Gaussian splatting, whose x and depth have the range of the
    picture's width."""
    head, body = path.read_bytes().split(b'end_header\n', 1)
    names = [line.split()[2].decode() for line in head.splitlines() if line.startswith(b'property')]
    rows = np.frombuffer(body, np.dtype([(name, '<f4') for name in names])).astype([(name, 'f8') for name in names])
    column = lambda *names: torch.from_numpy(np.stack([rows[name] for name in names], -1))
    x, y, z = column('x', 'y', 'z').unbind(-1)
    sx, sy, sz = column('scale_0', 'scale_1', 'scale_2').exp().unbind(-1)
    check(bool((column('rot_0', 'rot_1', 'rot_2', 'rot_3') == torch.tensor([1.0, 0, 0, 0])).all()), f'{path.name}: a Gaussian is turned')
    return {'position': torch.stack([x / aspect, z / aspect, -y], -1), 'scale': torch.stack([sx / aspect, sz / aspect, sy], -1), 'opacity': torch.sigmoid(column('opacity')),
            'rgb': 0.5 + 0.28209479177387814 * column('f_dc_0', 'f_dc_1', 'f_dc_2')}


def drawn(settings, handed, by_tiles):
    """Their rasteriser's image by its formulas, in binary64: orthographic, a low-pass of 0.3 px², α of at most 0.99 and at least 1/255, T of at least 10⁻⁴. Footprints end
    at tiles of 16×16 that three standard deviations of the longer axis touch, or nowhere."""
    # Thousands of small steps: more threads would only wait for each other.
    torch.set_num_threads(1)
    h, w = settings.image_height, settings.image_width
    mean = torch.cat([handed['means3D'].double(), torch.ones(len(handed['means3D']), 1, dtype=torch.float64)], -1)
    view, whole = settings.viewmatrix.double(), settings.projmatrix.double()
    in_view, projected = mean @ view, mean @ whole
    r, i, j, k = handed['rotations'].double().unbind(-1)
    turn = torch.stack([1 - 2 * (j * j + k * k), 2 * (i * j - r * k), 2 * (i * k + r * j), 2 * (i * j + r * k), 1 - 2 * (i * i + k * k), 2 * (j * k - r * i),
                        2 * (i * k - r * j), 2 * (j * k + r * i), 1 - 2 * (i * i + j * j)], -1).reshape(-1, 3, 3)
    spread = turn @ torch.diag_embed(handed['scales'].double() ** 2) @ turn.mT
    lens = torch.diag(torch.tensor([w / (2 * settings.tanfovx), h / (2 * settings.tanfovy)], dtype=torch.float64))
    to_image = lens @ view[:3, :2].T
    cov = to_image @ spread @ to_image.T + 0.3 * torch.eye(2, dtype=torch.float64)
    a, b, c = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    det, mid = a * c - b * b, (a + c) / 2
    radius = (3 * (mid + (mid * mid - det).clamp_min(0.1).sqrt()).sqrt()).ceil()
    centre = ((projected[:, :2] / projected[:, 3:] + 1) * torch.tensor([w, h], dtype=torch.float64) - 1) / 2
    y, x = torch.meshgrid(torch.arange(h, dtype=torch.float64), torch.arange(w, dtype=torch.float64), indexing='ij')
    image, left, done = torch.zeros(3, h, w, dtype=torch.float64), torch.ones(h, w, dtype=torch.float64), torch.zeros(h, w, dtype=torch.bool)
    for n in torch.argsort(in_view[:, 2].float(), stable=True):
        if in_view[n, 2] <= 0:
            continue
        dx, dy = centre[n, 0] - x, centre[n, 1] - y
        power = -0.5 * (c[n] * dx * dx + a[n] * dy * dy) / det[n] + b[n] * dx * dy / det[n]
        alpha = (handed['opacities'][n].double() * power.exp()).clamp_max(0.99)
        seen = (alpha >= 1 / 255) & ~done
        if by_tiles:
            first, last = ((centre[n] - radius[n]) / 16).trunc(), ((centre[n] + radius[n] + 15) / 16).trunc()
            tile = torch.stack([(x / 16).floor(), (y / 16).floor()])
            seen &= ((tile >= first[:, None, None]) & (tile < last[:, None, None])).all(0)
        rest = left * (1 - alpha)
        ends = seen & (rest < 1e-4)
        done |= ends
        seen &= ~ends
        image += torch.where(seen, alpha * left, 0) * handed['colors_precomp'][n].double()[:, None, None]
        left = torch.where(seen, rest, left)
    torch.set_num_threads(2)
    return image + left * settings.bg.double()[:, None, None]


def whole_clip(name, seed, config, images=True):
    height, width = config['resolution']
    sys.modules['diff_gaussian_rasterization_kiui_orth'].GaussianRasterizer = Recorder
    sys.modules['diff_gaussian_rasterization_kiui_orth'].GaussianRasterizationSettings = types.SimpleNamespace
    folder = work / name
    small, small_depth = make_clip(folder, height, width, seed)
    # The steps of their script: every third frame, resized; depth scaled to [0, 1] by the range of all these maps; pairs, each at times from 0 to 1.
    keys = range(0, FRAMES, GAP)
    frames = torch.stack([reduced(folder / 'frames' / f'{k:03}.png', (height, width)) for k in keys])
    depths = torch.stack([reduced(folder / 'depth' / f'{k:03}.png', (height, width)) for k in keys])
    exact = all(torch.equal(f, small[k]) and torch.equal(d[0], small_depth[k]) for f, d, k in zip(frames, depths, keys))
    check(exact, f'{name}: expected a clip that is reduced without rounding')
    frames, depths = frames / 255, (depths - depths.min()) / (depths.max() - depths.min() + 1e-8)
    pairs = lambda planes: torch.stack([torch.stack([planes[k]] * GAP + [planes[k + 1]]) for k in range(len(planes) - 1)])
    data = {'frames': pairs(frames), 'depths': pairs(depths), 'timestamps': torch.linspace(0, 1, GAP + 1).repeat(len(keys) - 1, 1)}
    opt = options_of(config, input_frames=1, output_frames=GAP + 1)
    Recorder.calls.clear()
    with OnCpu(), torch.no_grad():
        import model.encoder_model as base
        import model.splat_model_inference as theirs

        # Their class, with the network of seeded weights instead of those that it builds.
        base.GSPredictor = lambda *_, **__: torch.nn.Module()
        theirs.SplatPredictor = lambda opt: network(opt, seed, config['use_dino'])
        whole = theirs.SplatModel(opt).eval()
        whole(data)
    # Their script shows only the first frame of the first pair.
    shown = [call for n, call in enumerate(Recorder.calls) if n < GAP + 1 or n % (GAP + 1)]
    check(len(shown) == FRAMES, f'{name}: expected {FRAMES} images of theirs, found {len(shown)}')
    write_network(work / f'{name}.safetensors', whole.model, config)
    dino = []
    if config['use_dino']:
        torch.save(whole.model.condition_encoder.model.state_dict(), work / f'{name}-dinov2.pth')
        dino = ['--dinov2', work / f'{name}-dinov2.pth']

    def found(file, out):
        subprocess.run([streamsplat, 'run', folder / 'frames', '--depth', folder / 'depth', '--model', file, *dino, '--like-paper', '--fps', str(RATE), '--out', out, '--quiet'], check=True)
        times = ','.join(repr(k / RATE) for k in COMPARED)
        subprocess.run([streamsplat, 'export', out, '--format', 'ply', '--times', times, '--out', out / 'ply', '--quiet'], check=True)
        return [gaussians_of_ply(out / 'ply' / f'{n:06}.ply', width / height) for n in range(len(COMPARED))]

    inverse = lambda position: torch.stack([position[:, 0], 1 / position[:, 1].double(), position[:, 2]], -1)

    def errors(scenes):
        for k, scene in zip(COMPARED, scenes):
            handed = shown[k][1]
            # Depth is 1 / (0.2 + 9.8 y), which makes small errors of y large: it is compared as its inverse.
            theirs = {'position': inverse(handed['means3D']), 'scale': handed['scales'], 'opacity': handed['opacities'], 'rgb': handed['colors_precomp']}
            # A file has no invisible Gaussians: none that are too faint or not in front.
            seen = (handed['opacities'][:, 0] >= 1 / 255) & (handed['means3D'][:, 1] > 0)
            ours = {**scene, 'position': inverse(scene['position'])}
            yield k, {key: relative(ours[key], tensor[seen]) for key, tensor in theirs.items()}

    for k, error in errors(found(work / f'{name}.safetensors', folder / 'out')):
        print(f'{name} frame {k}: ' + ', '.join(f'{key} {e:.1e}' for key, e in error.items()))
        for key, e in error.items():
            check(e <= BAR, f'{name} frame {k} {key}: expected a relative error of at most {BAR}, found {e}')
    for k in COMPARED[::3] if images else ():
        ours = torch.from_numpy(np.array(Image.open(folder / 'out' / 'frames' / f'{k:06}.png')).astype(np.float64)).movedim(-1, 0)
        for by_tiles, bar in ((False, 1.0), (True, 6.0)):
            theirs = drawn(*shown[k], by_tiles).clamp(0, 1) * 255
            most = float((ours - theirs).abs().max())
            print(f'{name} frame {k}, image, footprints end {"at tiles" if by_tiles else "at 1/255"}: {most:.2f}/255 at most')
            check(most <= bar, f'{name} frame {k}: expected samples within {bar}/255 of their formulas, found {most}')
    # A flipped bit in the same file is detected.
    write_network(work / f'{name}-flipped.safetensors', whole.model, config, flipped=True)
    worst = max(e for _, error in errors(found(work / f'{name}-flipped.safetensors', folder / 'flipped')) for e in error.values())
    check(worst > BAR, f'{name}: a flipped bit of a weight is not seen, {worst}')


# Files of other kinds: one line with the found and the expected kind.


def refused(name, words, arguments):
    told = subprocess.run([streamsplat, *arguments], capture_output=True, text=True)
    lines = told.stderr.strip().splitlines()
    good = told.returncode == 1 and len(lines) == 1 and all(word in lines[0] for word in words)
    check(good, f'{name}: expected one line with {words}, found exit code {told.returncode}, {told.stderr!r}')
    print(f'{name}: {lines[-1] if lines else ""}')


class Thing:
    """An object that is not a tensor."""


def wrong_files(clip):
    model = work / 'with-dino.safetensors'
    dino = work / 'with-dino-dinov2.pth'
    run = lambda m, d=None: ['run', clip, '--frames', '5', '--out', work / 'scene', '--overwrite', '--quiet', '--model', m, *(['--dinov2', d] if d else [])]
    subprocess.run([streamsplat, *run(model, dino)], check=True)
    check((work / 'scene' / 'scene' / 'scene.json').exists(), 'no scene from the files as they come')
    told = subprocess.run([streamsplat, 'inspect', model], capture_output=True, text=True, check=True).stdout
    check('--dinov2' in told, f'inspect of a model that needs DINOv2 names it: {told}')
    for file, names in (('official.pth', 'official'), ('timm.safetensors', 'timm'), ('transformers.bin', 'transformers')):
        told = subprocess.run([streamsplat, 'inspect', work / file], capture_output=True, text=True, check=True).stdout
        check('DINOv2' in told and f'names: {names}' in told, f'inspect of {file}: {told}')
    refused('without DINOv2', ['DINOv2', 'found none'], run(model))
    small = dino_official(384, 1, heads=6)
    torch.save(small.state_dict(), work / 'vits.pth')
    refused('ViT-S', ['768', '384', 'ViT-S'], run(model, work / 'vits.pth'))
    torch.save(dino_official(768, 1, registers=0, heads=12).state_dict(), work / 'no-registers.pth')
    refused('no registers', ['register tokens', 'found none'], run(model, work / 'no-registers.pth'))
    refused('the model as DINOv2', ['not DINOv2', 'StreamSplat checkpoint'], run(model, model))
    refused('DINOv2 as the model', ['not a StreamSplat checkpoint', 'file of DINOv2'], run(dino, dino))
    state = load_file(model)
    save_file({k: v for k, v in state.items() if 'gs_predictor' in k}, work / 'encoder.safetensors')
    refused('the encoder alone', ['encoder.safetensors', 'is missing'], run(work / 'encoder.safetensors', dino))
    weights = dino_official(768, 1, heads=12).state_dict()
    torch.save({'model': weights, 'epoch': 3}, work / 'training.pth')
    refused('a training state', ['expected a tensor under every name', 'dictionary'], run(model, work / 'training.pth'))
    torch.save(Thing(), work / 'object.pth')
    refused('an object', ['would build an object', 'Thing'], run(model, work / 'object.pth'))
    torch.save(dino_official(768, 1, heads=12), work / 'module.pth')
    refused('a whole module', ['would build an object', 'encoders.dinov2.models'], run(model, work / 'module.pth'))
    whole = dino.read_bytes()
    (work / 'cut.pth').write_bytes(whole[:len(whole) // 2])
    refused('a cut zip', ['cut.pth', 'not a whole zip archive'], run(model, work / 'cut.pth'))
    torch.save(weights, work / 'legacy.pth', _use_new_zipfile_serialization=False)
    refused('the old form', ['before 1.6'], run(model, work / 'legacy.pth'))
    # A pickle that calls a function: refused by its name, nothing is called.
    mark = work / 'called'
    pickled = pickle.dumps(types.SimpleNamespace(), protocol=2)
    with zipfile.ZipFile(work / 'calls.pth', 'w') as archive:
        archive.writestr('x/data.pkl', b'\x80\x02cos\nmkdir\nX' + len(str(mark)).to_bytes(4, 'little') + str(mark).encode() + b'\x85R.')
    refused('a pickle that would run code', ['would call os.mkdir'], run(model, work / 'calls.pth'))
    check(not mark.exists(), 'a pickle ran code')


if paper:
    streamsplat_parity('paper', 30, {'hidden_dim': 768, 'encoder_layers': 10, 'decoder_layers': 10, 'resolution': [288, 512], 'patch_size': 8, 'upsampler_window': 2304, 'use_dino': False})
else:
    official()
    of_timm()
    of_transformers()
    small = {'hidden_dim': 128, 'encoder_layers': 2, 'decoder_layers': 2, 'resolution': [48, 80], 'patch_size': 8, 'upsampler_window': 60}
    streamsplat_parity('without-dino', 10, {**small, 'use_dino': False})
    streamsplat_parity('with-dino', 20, {**small, 'use_dino': True})
    whole_clip('clip', 40, {**small, 'use_dino': False})
    whole_clip('clip-with-dino', 50, {**small, 'use_dino': True})
    streamsplat_parity('sampled', 25, {**small, 'use_dino': False, 'static_position': 'truncated_normal'}, pred_keys=['rgb', 'opacity', 'scale'], sample_keys=['xyz_static', 'xyz_dynamic'])
    wrong_files(sys.argv[4])
print(f'{len(failures)} failures')
sys.exit(bool(failures))
