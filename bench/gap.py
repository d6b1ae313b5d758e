"""Constants of `engine/src/gap/control.rs`: gap.py FILE…

Each FILE is the result of `streamsplat eval CLIPS --seen --gap N --json FILE`, for gaps N of 3 and more. With k the PSNR of an interval's last key frame,
q the mean PSNR of its n − 1 frames in between, and p the mean PSNR at which these are predicted from the key frames (all in dB), it prints the least-squares
fit of a and b in k − q = (a + b·max(k − p, 0))·ln(n/c), with the c of least error, the root mean square of what remains, and the median of k.
"""

import json
import math
import statistics
import sys


def fit(rows, c):
    """a, b, and the root mean square error."""
    ones = [(math.log(n / c), max(k - p, 0) * math.log(n / c), k - q) for n, k, q, p in rows]
    aa, ab, bb = (sum(x[i] * x[j] for x in ones) for i, j in ((0, 0), (0, 1), (1, 1)))
    ay, by = (sum(x[i] * x[2] for x in ones) for i in (0, 1))
    a, b = (ay * bb - by * ab) / (aa * bb - ab * ab), (by * aa - ay * ab) / (aa * bb - ab * ab)
    return a, b, math.sqrt(statistics.mean((a * x[0] + b * x[1] - x[2]) ** 2 for x in ones))


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    clips = [clip for path in sys.argv[1:] for clip in json.loads(open(path).read())['clips']]
    intervals = [one for clip in clips for one in clip['intervals'] if one['frames'] > 1 and one['between'] is not None and one['predicted'] is not None]
    rows = [(one['frames'], one['key'], one['between'], one['predicted']) for one in intervals]
    c = min((i / 100 for i in range(30, 200, 5)), key=lambda c: fit(rows, c)[2])
    a, b, error = fit(rows, c)
    print(f'{len(rows)} intervals: a {a:.2f}, b {b:.2f}, c {c:.2f}, error {error:.2f} dB; median of k {statistics.median(row[1] for row in rows):.1f} dB')


if __name__ == '__main__':
    main()
