#!/usr/bin/env bash
# Runs a program on emulated x86-64 CPUs of another kind: tests/emulated/x86.sh CPU PROGRAM ARGUMENTS…
#   Nehalem has neither AVX2 nor FMA, Haswell has both and no AVX-512. qemu's user emulation, installed by apt where it is missing.
set -euo pipefail
cpu=$1; shift
if ! command -v qemu-x86_64-static >/dev/null; then
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq qemu-user-static >/dev/null
fi
# qemu prints for every thread the CPU features that it does not emulate; none of them is arithmetic.
qemu-x86_64-static -cpu "$cpu" "$@" 2> >(grep -v "TCG doesn't support requested feature" >&2)
