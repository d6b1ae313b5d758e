"""The authors' own modules beside this program, on seeded weights.

usage: check.py STREAMSPLAT SOURCE WORK [--paper]

STREAMSPLAT is the program, SOURCE the unpacked source of `streamsplat` 0.1.4 from PyPI, WORK a folder for files. Every file of weights is written by the library
whose format it is: torch.save, safetensors, timm and transformers.
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
paper = '--paper' in sys.argv
sys.path.insert(0, source)

import numpy as np
import torch
from safetensors.torch import load_file, save_file

torch.set_num_threads(2)
BAR = 3e-6  # relative error of a tensor, in the Euclidean norm

# Not needed for the modules compared here, and imported by their files: rasterisers, viewers, training.
for name in ('kiui', 'kiui.op', 'lpips', 'wandb', 'pdb'):
    sys.modules.setdefault(name, types.ModuleType(name))

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
    """`streamsplat forward`: the program's tensors for these inputs."""
    save_file({k: v.contiguous() for k, v in inputs.items()}, work / f'{name}.in.safetensors')
    out = work / f'{name}.out.safetensors'
    subprocess.run([streamsplat, 'forward', '--model', model, '--input', work / f'{name}.in.safetensors', '--output', out, '--quiet'], check=True)
    return load_file(out)


def compare(name, found, expected):
    for key, tensor in expected.items():
        error = relative(found[key], tensor)
        print(f'{name} {key}: {error:.1e}')
        check(error <= BAR, f'{name} {key}: expected a relative error of at most {BAR}, found {error}')


def seeded(module, seed):
    """Weights of a known spread in every parameter, those that start at zero too."""
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
    # One weight's bit flipped is seen.
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

    # The authors' class fetches its weights; here it has seeded ones.
    utils.Dinov2Wrapper._build_dinov2 = staticmethod(lambda *_, **__: dino_official(768, 1, heads=12))
    predictor = SplatPredictor(options)
    out = predictor.gs_predictor.gaussian_upsampler.out_channels
    # 192 stands in their code for the width after upsampling at the published size.
    predictor.encoder_proj = torch.nn.Linear(out, out, bias=False)
    # Their condition is as wide as their tokens, 768 both; here tokens are narrower.
    decoder = predictor.decoder.transformer_decoder
    if use_dino and decoder.condition_proj.in_features != 768:
        decoder.condition_proj = torch.nn.Linear(768, decoder.condition_proj.out_features, bias=False)
    return seeded(predictor, seed)


def options(**changes):
    from configs.options_inference import Options

    return Options(**{'checkpointing': False, 'compile': False, **changes})


def streamsplat_parity(name, seed, config, **changes):
    height, width = config['resolution']
    opt = options(hidden_dim=config['hidden_dim'], decoder_hidden_dim=config['hidden_dim'], num_layers=config['encoder_layers'], decoder_num_layers=config['decoder_layers'],
                  image_height=height, image_width=width, down_resolution=(height, width), window_size=config['upsampler_window'], use_dino=config['use_dino'], **changes)
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
    state = {f'model.{k}': v.contiguous() for k, v in predictor.state_dict().items()}
    save_file(state, file)
    (work / f'{name}.json').write_text(json.dumps({'config': config}))
    inputs = {'in.frames': frames[0], 'in.depths': depths[0]}
    if config['use_dino']:
        inputs['in.condition'] = condition[0]
    compare(name, forward(file, inputs, name), expected)
    if config['use_dino']:
        torch.save(predictor.condition_encoder.model.state_dict(), work / f'{name}-dinov2.pth')


# Files that are something else: one line that tells what was found, and what was expected.


def refused(name, words, arguments):
    told = subprocess.run([streamsplat, *arguments], capture_output=True, text=True)
    lines = told.stderr.strip().splitlines()
    good = told.returncode == 1 and len(lines) == 1 and all(word in lines[0] for word in words)
    check(good, f'{name}: expected one line with {words}, found exit code {told.returncode}, {told.stderr!r}')
    print(f'{name}: {lines[-1] if lines else ""}')


class Thing:
    """An object that is no tensor."""


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
    streamsplat_parity('sampled', 25, {**small, 'use_dino': False, 'static_position': 'truncated_normal'}, pred_keys=['rgb', 'opacity', 'scale'], sample_keys=['xyz_static', 'xyz_dynamic'])
    wrong_files(sys.argv[4])
print(f'{len(failures)} failures')
sys.exit(bool(failures))
