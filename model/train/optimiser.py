"""One optimiser for matrices and for everything else.

Matrices between other layers take steps of equal size in all their directions (Muon: momentum, then the nearest semi-orthogonal matrix). Gains, biases and the
small output layers take Adam's steps. With per-weight steps the upsampler does not leave its start: the analytic start is a sum of strong and faint directions,
and Adam's step follows the strong ones.
"""
import torch


def orthogonal(g, steps=5):
    """Nearest semi-orthogonal matrices of a batch [.., m, n], to a few tenths in their singular values: a quintic Newton-Schulz iteration."""
    a, b, c = 3.4445, -4.7750, 2.0315
    x = g / (g.norm(dim=(-2, -1), keepdim=True) + 1e-12)
    tall = x.shape[-2] > x.shape[-1]
    x = x.mT if tall else x
    for _ in range(steps):
        m = x @ x.mT
        x = a * x + (b * m + c * m @ m) @ x
    return x.mT if tall else x


class Mixed(torch.optim.Optimizer):
    """Groups of kind `adam` (default) or `matrix`; `parts`: the number of matrices stacked in one stored matrix."""

    def __init__(self, groups):
        super().__init__(groups, dict(lr=1e-3, kind='adam', parts=1, momentum=0.95, betas=(0.9, 0.98), eps=1e-10))

    @torch.no_grad()
    def step(self):
        for group in self.param_groups:
            move = self._matrix if group['kind'] == 'matrix' else self._adam
            for p in group['params']:
                if p.grad is not None:
                    move(p, self.state[p], group)

    @staticmethod
    def _matrix(p, state, group):
        if not state:
            state['m'] = torch.zeros_like(p)
        state['m'].lerp_(p.grad, 1 - group['momentum'])
        u = p.grad.lerp(state['m'], group['momentum'])
        o = orthogonal(u.reshape(group['parts'], p.shape[0] // group['parts'], -1))
        p.add_(o.reshape(p.shape), alpha=-group['lr'] * max(1.0, o.shape[-2] / o.shape[-1]) ** 0.5)

    @staticmethod
    def _adam(p, state, group):
        if not state:
            state.update(m=torch.zeros_like(p), v=torch.zeros_like(p), n=0)
        state['n'] += 1
        b1, b2 = group['betas']
        state['m'].lerp_(p.grad, 1 - b1)
        state['v'].mul_(b2).addcmul_(p.grad, p.grad, value=1 - b2)
        root = (state['v'] / (1 - b2 ** state['n'])).sqrt_().add_(group['eps'])
        p.addcdiv_(state['m'] / (1 - b1 ** state['n']), root, value=-group['lr'])


def groups_of(module, matrix, rest, output=(), slow=(), skip=()):
    """Splits a module's parameters: name parts in `output` and `rest` go to Adam, `slow` = {name part: rate} overrides a matrix's rate."""
    slow, groups = dict(slow), []
    for name, p in module.named_parameters():
        if any(s in name for s in skip):
            continue
        if p.dim() < 2 or any(s in name for s in output):
            groups.append(dict(params=[p], lr=rest, kind='adam'))
            continue
        rate = next((r for s, r in slow.items() if s in name), matrix)
        groups.append(dict(params=[p], lr=rate, kind='matrix', parts=3 if 'packed_proj' in name else 1))
    return groups
