// Bytes in text, as text.rs has them.

/** Characters of text.rs, as the numbers they stand for. */
const DIGITS = new Uint8Array(128);
{
  let digit = 0;
  for (let code = 0x21; code < 0x7f; code++) if (!"&<\\".includes(String.fromCharCode(code))) DIGITS[code] = digit++;
}

/** The bytes of a text: 13 bits in two characters. */
function bytesOf(text) {
  const bytes = new Uint8Array(Math.floor((text.length / 2) * (13 / 8)));
  let [word, bits, at] = [0, 0, 0];
  for (let k = 0; k + 1 < text.length; k += 2) {
    word |= (DIGITS[text.charCodeAt(k)] + 91 * DIGITS[text.charCodeAt(k + 1)]) << bits;
    for (bits += 13; bits >= 8; bits -= 8) {
      bytes[at++] = word & 255;
      word >>>= 8;
    }
  }
  return bytes;
}
