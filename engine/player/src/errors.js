/** An error that names the part of the file. */
export const wrong = (part, expected, found) => new Error(`${part}: expected ${expected}, found ${found}`);
