#!/usr/bin/env bash
# Runs cargo for 64-bit ARM on an x86-64 Debian machine, as root: tests/emulated/aarch64.sh CARGO-ARGUMENTS…
#   e.g. tests/emulated/aarch64.sh test --release -p streamsplat-kernels
# The installed toolchain needs no ARM standard library. A Debian unstable tree with its own rustc and the arm64 library of the same version is unpacked once
# into $AARCH64_ROOT (about 2 GB). Its builds run under qemu's user emulation.
set -euo pipefail
cd "$(dirname "$0")/../.."
root=${AARCH64_ROOT:-/var/tmp/aarch64-root}
if [ ! -e "$root/.complete" ]; then
  echo "aarch64: preparing $root (log: $root.log)" >&2
  if ! command -v debootstrap >/dev/null || ! command -v qemu-aarch64-static >/dev/null; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq debootstrap qemu-user-static >/dev/null
  fi
  mirror=$(cat /etc/apt/sources.list /etc/apt/sources.list.d/* 2>/dev/null | grep -E '^(URIs:|deb) ' |
    grep -oE 'https?://[^ ]+/debian/?( |$)' | head -n 1 | tr -d ' ' || true)
  rm -rf "$root"
  {
    debootstrap --variant=minbase --include=ca-certificates sid "$root" "${mirror:-http://deb.debian.org/debian}"
    echo 'Acquire::Check-Valid-Until "false";' >"$root/etc/apt/apt.conf.d/99valid"
    chroot "$root" sh -c "dpkg --add-architecture arm64 && apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install \
      -y -qq --no-install-recommends rustc cargo libstd-rust-dev:arm64 gcc-aarch64-linux-gnu libc6-dev-arm64-cross gcc libc6-dev"
  } >"$root.log" 2>&1 || { tail -n 20 "$root.log" >&2; exit 1; }
  touch "$root/.complete"
fi
home=${CARGO_HOME:-$HOME/.cargo}
cargo fetch --quiet --locked
mkdir -p "$root/ws" "$root/cargo/registry" "$root/target"
cp -f "$(command -v qemu-aarch64-static)" "$root/usr/bin/"
# The files in git, with changes of the working tree; modification times are kept, so that a second build is incremental.
git ls-files -z --cached --others --exclude-standard | (cd "$PWD" && tar --null --ignore-failed-read -cf - -T - 2>/dev/null) |
  (rm -rf "${root:?}/ws" && mkdir -p "$root/ws" && tar -C "$root/ws" -xf -)
cp -au "$home/registry/." "$root/cargo/registry/"
exec chroot "$root" env -i PATH=/usr/bin:/bin HOME=/root CARGO_HOME=/cargo CARGO_TARGET_DIR=/target CARGO_NET_OFFLINE=true \
  CARGO_BUILD_TARGET=aarch64-unknown-linux-gnu \
  CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
  CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64-static -L /usr/aarch64-linux-gnu" \
  sh -c 'cd /ws && exec cargo "$@"' cargo "$@"
