"""A run's folder: the state from which it resumes exactly, its log and its curve."""
import csv
import json
import os
import pathlib

import torch


class Run:
    """`folder/state.pt` (written to a temporary name and renamed), `folder/log.csv`, `folder/curve.png`."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)

    @property
    def state(self):
        path = self.folder / 'state.pt'
        return torch.load(path, map_location='cpu', weights_only=True) if path.exists() else None

    def save(self, state):
        torch.save(state, self.folder / 'state.tmp')
        os.replace(self.folder / 'state.tmp', self.folder / 'state.pt')

    def log(self, row):
        """Writes one line; columns that appear later are added to the file."""
        path = self.folder / 'log.csv'
        rows = self.rows()
        columns = list(rows[0]) if rows else []
        columns += [k for k in row if k not in columns]
        if rows and len(columns) == len(rows[0]):
            with open(path, 'a', newline='') as f:
                csv.DictWriter(f, columns).writerow(row)
            return
        with open(path, 'w', newline='') as f:
            writer = csv.DictWriter(f, columns)
            writer.writeheader()
            writer.writerows([*rows, row])

    def rows(self):
        path = self.folder / 'log.csv'
        if not path.exists():
            return []
        with open(path, newline='') as f:
            return list(csv.DictReader(f))

    def curve(self):
        import matplotlib
        matplotlib.use('Agg')
        from matplotlib import pyplot as plt
        rows = self.rows()
        keys = [k for k in ('key', 'middle', 'crossfade', 'epe', 'epe_zero') if any(r.get(k) for r in rows)]
        if not keys:
            return
        figure, axes = plt.subplots(len(keys), 1, figsize=(8, 2.2 * len(keys)), sharex=True, squeeze=False)
        for a, k in zip(axes[:, 0], keys):
            for stage in dict.fromkeys(r['stage'] for r in rows):
                points = [(float(r['total_minutes']), float(r[k])) for r in rows if r.get(k) and r['stage'] == stage]
                if points:
                    a.plot(*zip(*points), label=stage)
            a.set_ylabel(k)
            a.grid(alpha=0.3)
        axes[0, 0].legend(fontsize=8)
        axes[-1, 0].set_xlabel('minutes')
        figure.tight_layout()
        figure.savefig(self.folder / 'curve.png', dpi=90)
        plt.close(figure)

    def note(self, name, entries):
        with open(self.folder / f'{name}.json', 'w') as f:
            json.dump(entries, f, indent=1)
