"""The part of PyTorch's interface that gsplat's reference formulas need, over NumPy in float64. So they run unchanged, and gigabytes of PyTorch need not be
installed for a few products."""
import types

import numpy as np


class Tensor(np.ndarray):
    """An array with the few methods of PyTorch's that NumPy's lack."""

    device = None

    def transpose(self, a, b):
        return self.swapaxes(a, b)

    def clamp(self, min=None, max=None):
        return np.clip(self, min, max)

    def unbind(self, dim):
        return unbind(self, dim)

    def int(self):
        return self.astype(np.int64)

    def sum(self, dim=None, **words):
        return super().sum(**({'axis': dim} | words))


def tensor(values):
    return np.asarray(values, np.float64).view(Tensor)


def _joined(function):
    return lambda values, dim=0: function(values, axis=dim).view(Tensor)


def unbind(values, dim):
    return [np.take(values, i, axis=dim) for i in range(values.shape[dim])]


def normalize(values, p, dim):
    assert p == 2
    return values / np.maximum(np.linalg.norm(values, axis=dim, keepdims=True), 1e-12)


def no_grad():
    return lambda function: function


def _array(function):
    return lambda shape, dtype=None, device=None: function(shape).view(Tensor)


def clamp(values, min=None, max=None):
    return np.clip(values, min, max)


def clamp_max(values, most):
    return np.minimum(values, most)


def einsum(form, *values):
    return np.einsum(form.replace(' ', ''), *values).view(Tensor)


stack, cat = _joined(np.stack), _joined(np.concatenate)
zeros, empty, ones, eye = map(_array, (np.zeros, np.empty, np.ones, np.eye))
zeros_like, sqrt, exp, ceil = np.zeros_like, np.sqrt, np.exp, np.ceil
nn = types.ModuleType('torch.nn')
nn.functional = types.ModuleType('torch.nn.functional')
nn.functional.normalize = normalize
