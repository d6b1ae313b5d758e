#!/usr/bin/env bash
# Package: @mkkellogg/gaussian-splats-3d 0.4.7 with three 0.169.0 (npm), on a valid PLY file of degree 3 in the layout of 3D Gaussian splatting.
# Behaviour: `PlyLoader.loadFromFileData`, requested to load harmonics of degree 3, makes a buffer (the content of a .ksplat file) of degree 2. The third band,
#   21 of 45 coefficients, is lost without a message. The library's own table of coefficients has an entry for degree 3.
# Guess beforehand: degree 3, or an error.
# Output seen:
#   requested 0 1 2 3, stored 0 1 2 2
# Consequence: a .ksplat file is not a copy of a trained scene, even at compression level 0; convert from the PLY file.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
echo '{"type": "module"}' >package.json
npm install --silent --no-audit --no-fund @mkkellogg/gaussian-splats-3d@0.4.7 three@0.169.0 >/dev/null
cat >try.mjs <<'END'
// The package asks for a browser's window when it is loaded.
globalThis.window ??= globalThis;
const { PlyLoader } = await import('@mkkellogg/gaussian-splats-3d');
const names = ['x', 'y', 'z', 'nx', 'ny', 'nz', 'f_dc_0', 'f_dc_1', 'f_dc_2', ...Array.from({ length: 45 }, (_, i) => `f_rest_${i}`),
  'opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3'];
const header = `ply\nformat binary_little_endian 1.0\nelement vertex 2\n${names.map((name) => `property float ${name}\n`).join('')}end_header\n`;
const values = new Float32Array(2 * names.length).fill(0.5);
const bytes = Uint8Array.from(Buffer.concat([Buffer.from(header), Buffer.from(values.buffer)])).buffer;
const asked = [0, 1, 2, 3];
const stored = [];
for (const degree of asked) {
  const buffer = await PlyLoader.loadFromFileData(bytes.slice(0), 1, 0, true, degree);
  stored.push(buffer.getMinSphericalHarmonicsDegree());
}
console.log(`requested ${asked.join(' ')}, stored ${stored.join(' ')}`);
END
found=$(node --no-deprecation try.mjs)
echo "$found"
[ "$found" = 'requested 0 1 2 3, stored 0 1 2 2' ]
