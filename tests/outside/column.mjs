// Columns of a container's chunk for tests: docs/container.md, "A column". All tokens that occur have one weight, in one table.

/** The token of a number, and its extra bits with their count. */
function tokenOf(x) {
  if (x < 8n) return [Number(x), 0n, 0];
  const bits = x.toString(2).length - 3;
  const extra = x & ((1n << BigInt(bits)) - 1n);
  return [4 * bits + 4 + Number((x >> BigInt(bits)) & 3n), extra, bits];
}

/** Returns a column of unsigned numbers, each below 2⁶⁴, as it is stored. */
export function columnOf(numbers) {
  const tokens = numbers.map((x) => tokenOf(BigInt(x)));
  const used = [...new Set(tokens.map(([token]) => token))].sort((a, b) => a - b);
  const codes = Buffer.alloc((used.at(-1) ?? -1) + 1);
  for (const token of used) codes[token] = 1;
  const startOf = (k) => Math.floor((4096 * k) / used.length);
  const words = [];
  let state = 65536;
  for (const [token] of tokens.toReversed()) {
    const k = used.indexOf(token);
    const [start, part] = [startOf(k), startOf(k + 1) - startOf(k)];
    if (state >= part * 2 ** 20) {
      words.push(state % 65536);
      state = Math.floor(state / 65536);
    }
    state = Math.floor(state / part) * 4096 + (state % part) + start;
  }
  words.push(state % 65536, Math.floor(state / 65536));
  let [held, count] = [0n, 0n];
  for (const [, extra, bits] of tokens) {
    held |= extra << count;
    count += BigInt(bits);
  }
  const extra = Array.from({ length: Math.ceil(Number(count) / 8) }, (_, k) => Number((held >> BigInt(8 * k)) & 255n));
  const coded = Buffer.alloc(4 + 2 * words.length);
  coded.writeUInt32LE(words.length);
  words.toReversed().forEach((word, k) => coded.writeUInt16LE(word, 4 + 2 * k));
  const bytes = numbers.length ? Buffer.concat([Buffer.of(1, codes.length), codes, coded, Buffer.from(extra)]) : Buffer.alloc(0);
  const lengths = Buffer.alloc(8);
  [numbers.length, bytes.length].forEach((length, k) => lengths.writeUInt32LE(length, 4 * k));
  return Buffer.concat([lengths, bytes]);
}
