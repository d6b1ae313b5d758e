#!/usr/bin/env bash
# The digests of everything computed, on CPUs this machine is not: tests/emulated/run.sh [short|full]
#   short  x86-64 without AVX2 and FMA (scalar level), with AVX2 (avx2 level) and 64-bit ARM (neon level): the things in fixtures/golden/digests.txt
#          that take seconds.
#   full   all things there, on all of these and on an emulated AVX-512 CPU. Takes an hour or so.
# Every line printed elsewhere must be the line in fixtures/golden/digests.txt, which the tests compare with this machine's own.
set -euo pipefail
cd "$(dirname "$0")/../.."
how=${1:-short}
golden=fixtures/golden/digests.txt
case $how in
short) things=(math/exp math/erfinv math/sin_cos math/f64 gemm attention norm philox truncated splats/perspective splats/extreme network/tiny-sampled) ;;
full) things=(/ norm patches philox pixel_shuffle truncated) ;;
*) echo "usage: tests/emulated/run.sh [short|full]" >&2; exit 2 ;;
esac
cargo build --release --quiet --locked -p streamsplat-tests --bin digests
program=${CARGO_TARGET_DIR:-target}/release/digests
export STREAMSPLAT_FIXTURES=$PWD/fixtures
passed=0 failed=0
try() { # what, command…
  local what=$1; shift
  local from=$SECONDS
  if "$@" >/dev/null; then passed=$((passed + 1)); else failed=$((failed + 1)); what="$what FAILED"; fi
  echo "emulated: $what ($((SECONDS - from)) s)"
}
try "x86-64 without AVX2 and FMA" tests/emulated/x86.sh Nehalem "$program" --levels scalar --threads 3 --check "$golden" "${things[@]}"
try "x86-64 with AVX2" tests/emulated/x86.sh Haswell "$program" --levels avx2 --threads 3 --check "$golden" "${things[@]}"
try "64-bit ARM" tests/emulated/aarch64.sh run --release --quiet --locked -p streamsplat-tests --bin digests -- \
  --levels neon --threads 3 --check "$golden" "${things[@]}"
if [ "$how" = full ]; then
  with=(--with "$golden")
  for file in fixtures/oracle/*.safetensors fixtures/parity/tiny-{nodino,sampled,window}*; do with+=(--with "$file"); done
  try "x86-64 with AVX-512" tests/emulated/avx512.sh "${with[@]}" "$program" --levels avx512 --threads 2 --check "$golden" "${things[@]}"
fi
echo "emulated: $passed passed, $failed failed"
[ "$failed" -eq 0 ]
