#!/usr/bin/env bash
# All digests on emulated CPUs of other kinds: tests/emulated/run.sh [short|full]
# x86-64 without AVX2 and FMA (scalar level), with AVX2 (avx2), with AVX-512 (avx512), and 64-bit ARM (neon).
#   short  every kernel, two scenes, and the smallest network (default)
#   full   all things in fixtures/golden/digests.txt
# Every line printed there must equal the line in fixtures/golden/digests.txt, which the tests compare with this machine's digests.
set -euo pipefail
cd "$(dirname "$0")/../.."
how=${1:-short}
golden=fixtures/golden/digests.txt
case $how in
short) things=(math/ gemm attention flow resize norm philox patches pointwise truncated colour-map splats/perspective splats/extreme network/tiny-sampled) ;;
full) things=(/ flow norm patches philox pointwise resize truncated) ;;
*) echo "usage: tests/emulated/run.sh [short|full]" >&2; exit 2 ;;
esac
[ -n "${STREAMSPLAT_TESTED:-}" ] || cargo build --release --quiet --locked -p streamsplat-tests --bin digests
program=${CARGO_TARGET_DIR:-target}/release/digests
export STREAMSPLAT_FIXTURES=$PWD/fixtures
passed=0 failed=0
printed=$(mktemp); trap 'rm -f "$printed"' EXIT
try() { # what, command…
  local what=$1; shift
  local from=$SECONDS
  if "$@" >"$printed"; then passed=$((passed + 1)); else failed=$((failed + 1)); what="$what FAILED"; cat "$printed"; fi
  echo "emulated: $what ($((SECONDS - from)) s)"
}
try "x86-64 without AVX2 and FMA" tests/emulated/x86.sh Nehalem "$program" --levels scalar --threads 3 --check "$golden" "${things[@]}"
try "x86-64 with AVX2" tests/emulated/x86.sh Haswell "$program" --levels avx2 --threads 3 --check "$golden" "${things[@]}"
try "64-bit ARM" tests/emulated/aarch64.sh run --release --quiet --locked -p streamsplat-tests --bin digests -- \
  --levels neon --threads 3 --check "$golden" "${things[@]}"
with=(--with "$golden")
for file in fixtures/oracle/*.safetensors fixtures/parity/tiny-{nodino,sampled,window}*; do with+=(--with "$file"); done
try "x86-64 with AVX-512" tests/emulated/avx512.sh "${with[@]}" "$program" --levels avx512 --threads 2 --check "$golden" "${things[@]}"
echo "emulated: $passed passed, $failed failed"
[ "$failed" -eq 0 ]
