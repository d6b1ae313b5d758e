# Sourced by findings on SPZ files, in an empty folder: installs the two packages, and writes one.mjs with the code that their scripts share.
echo '{"type": "module"}' >package.json
npm install --silent --no-audit --no-fund @adobe/spz@0.2.3 @playcanvas/splat-transform@3.7.0 playcanvas@2.23.3 >/dev/null
cat >one.mjs <<'END'
import { execFileSync } from 'node:child_process';
import { readFileSync, writeFileSync } from 'node:fs';

/** Writes one.ply: one Gaussian at this place. */
export function write(place) {
  const names = 'x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split(' ');
  const header = `ply\nformat binary_little_endian 1.0\nelement vertex 1\n${names.map((name) => `property float ${name}\n`).join('')}end_header\n`;
  writeFileSync('one.ply', Buffer.concat([Buffer.from(header), Buffer.from(Float32Array.from([...place, 0, 0, 0, 1, -2, -2, -2, 1, 0, 0, 0]).buffer)]));
}

/** Converts one.ply to one.spz and back, by splat-transform, and returns the place. */
export function thereAndBack(...options) {
  for (const words of [[...options, 'one.ply', 'one.spz'], ['one.spz', 'back.ply']]) {
    execFileSync(process.execPath, ['node_modules/@playcanvas/splat-transform/bin/cli.mjs', '--quiet', '--overwrite', ...words], { stdio: 'ignore' });
  }
  const bytes = readFileSync('back.ply');
  const at = bytes.indexOf('end_header\n') + 11;
  return [0, 4, 8].map((axis) => bytes.readFloatLE(at + axis));
}
END
