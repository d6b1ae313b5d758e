#!/usr/bin/env bash
# Package: transformers 5.24.0 with torch 2.15.0 (PyPI), a `Dinov2WithRegistersModel` with random weights. The same is true of `Dinov2Model`.
# Behaviour: the tensors of attention have other names in the model's `state_dict()` than in the file that `save_pretrained` writes, which has the names of the published
#   files. `load_state_dict` of the model's own file finds all 8 of a layer missing. With `strict=False` attention keeps its random weights, and nothing is raised.
#   `from_pretrained` reads both sets of names.
# Guess beforehand: one set of names, so that a model loads the file that it wrote.
# Output seen:
#   in memory: encoder.layer.0.attention.q_proj.weight
#   in the file: encoder.layer.0.attention.attention.query.weight
#   strict: missing 8; strict=False: missing 8, attention still as it was: True; from_pretrained: equal True
# Consequence: a reader of DINOv2's weights must accept both sets of names; a tool that loads a published file into the module must use `from_pretrained`.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
if [ -z "${PYTHON:-}" ]; then
  # About 6 GB, mostly CUDA packages that PyTorch's wheel requires. PYTHON=… names an interpreter that already has both packages.
  python3 -m venv "$folder/venv"
  "$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.15.0 transformers==5.24.0 numpy==2.4.6
  PYTHON=$folder/venv/bin/python
fi
cat >"$folder/try.py" <<'END'
import sys

import torch
import transformers
from safetensors.torch import load_file
from transformers import Dinov2WithRegistersConfig, Dinov2WithRegistersModel

assert transformers.__version__ == '5.24.0', transformers.__version__
torch.manual_seed(0)
config = Dinov2WithRegistersConfig(hidden_size=32, num_hidden_layers=1, num_attention_heads=2)
saved, other = Dinov2WithRegistersModel(config), Dinov2WithRegistersModel(config)
saved.save_pretrained(sys.argv[1])
file = load_file(sys.argv[1] + '/model.safetensors')
only = lambda a, b: sorted(key for key in a if key not in b and 'q' in key.split('.')[-2] and key.endswith('weight'))
print('in memory:', *only(saved.state_dict(), file))
print('in the file:', *only(file, saved.state_dict()))
try:
    other.load_state_dict(file)
    strict = 'loads'
except RuntimeError as error:
    strict = f"missing {str(error).split('Unexpected')[0].count('attention.')}"
query = 'encoder.layer.0.attention.q_proj.weight'
before = other.state_dict()[query].clone()
missing = other.load_state_dict(file, strict=False).missing_keys
kept = torch.equal(other.state_dict()[query], before) and not torch.equal(before, saved.state_dict()[query])
read = Dinov2WithRegistersModel.from_pretrained(sys.argv[1])
equal = all(torch.equal(a, b) for a, b in zip(saved.state_dict().values(), read.state_dict().values()))
print(f'strict: {strict}; strict=False: missing {len(missing)}, attention still as it was: {kept}; from_pretrained: equal {equal}')
END
found=$("$PYTHON" "$folder/try.py" "$folder/model" 2>/dev/null)
echo "$found"
[ "$found" = 'in memory: encoder.layer.0.attention.q_proj.weight
in the file: encoder.layer.0.attention.attention.query.weight
strict: missing 8; strict=False: missing 8, attention still as it was: True; from_pretrained: equal True' ]
