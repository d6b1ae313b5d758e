#!/usr/bin/env bash
# Runs a program on an emulated x86-64 CPU with AVX-512: tests/emulated/avx512.sh [--with FILE]… PROGRAM ARGUMENTS…
#   e.g. tests/emulated/avx512.sh --with fixtures/parity/tiny-nodino.json target/release/digests --level avx512
# qemu's user emulation does not support AVX-512; Bochs does (a Skylake-X, some 20 million instructions a second). It boots Debian's cloud kernel with an
# initial file system that holds the program, its shared libraries and the files of --with (under their own paths), and prints the program's output. The exit
# status is the program's. Runs as root on Debian; missing packages are installed by apt. Bochs 2.7 returns 0 where a mask register is shifted by 15 places
# (kshiftlw, kshiftrw; fixed in its repository, pull request 844). So vectors that compilers assemble lane by lane lose their last lane, only in this emulation.
set -euo pipefail
cd "$(dirname "$0")/../.."
cache=${BOCHS_CACHE:-/var/tmp/streamsplat-bochs}
limit=${BOCHS_LIMIT:-3000}
files=()
while [ "${1:-}" = --with ]; do files+=("$2"); shift 2; done
program=$1; shift

packages=(bochs bochs-term bochsbios vgabios isolinux syslinux-common xorriso cpio busybox-static bsdutils)
if ! dpkg -s "${packages[@]}" >/dev/null 2>&1; then
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null
fi
mkdir -p "$cache"
if [ ! -e "$cache/vmlinuz" ]; then
  apt-cache show linux-image-cloud-amd64 >/dev/null 2>&1 || apt-get update -qq
  kernel=$(apt-cache depends linux-image-cloud-amd64 | grep -oE 'linux-image-[0-9.]+-[0-9]+-cloud-amd64' | head -n 1 || true)
  [ -n "$kernel" ] || { echo "avx512: no Debian cloud kernel to be had" >&2; exit 1; }
  (cd "$cache" && apt-get download -q "$kernel" >/dev/null 2>&1 && dpkg -x "$kernel"_*.deb deb && mv deb/boot/vmlinuz-* vmlinuz && rm -rf deb ./*.deb)
fi

work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
init=$work/init
mkdir -p "$init"/{bin,proc,sys,dev,tmp} "$work/iso/isolinux"
cp "$(command -v busybox)" "$init/bin/busybox"; ln -s busybox "$init/bin/sh"
cp "$program" "$init/bin/program"; strip "$init/bin/program"
ldd "$program" | grep -oE '/[^ ]+' | while read -r library; do mkdir -p "$init$(dirname "$library")"; cp -L "$library" "$init$library"; done
for file in "${files[@]}"; do mkdir -p "$init/$(dirname "$file")"; cp "$file" "$init/$file"; done
{
  echo '#!/bin/sh'
  # Test programs print one line per test in any case; one thread avoids switching on the emulated single CPU.
  printf 'export RUST_TEST_THREADS=1 STREAMSPLAT_FIXTURES=/fixtures\nexec /bin/program'
  [ $# -eq 0 ] || printf ' %q' "$@"
  echo
} >"$init/bin/run"
cat >"$init/init" <<'INIT'
#!/bin/sh
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t devtmpfs dev /dev
/bin/busybox mount -t tmpfs tmp /tmp
cd /
echo "@flags $(/bin/busybox grep -o 'avx512[a-z_]*' /proc/cpuinfo | /bin/busybox tr '\n' ' ')"
echo "@begin"
/bin/run 2>&1
echo "@exit $?"
/bin/busybox poweroff -f
INIT
chmod +x "$init/init" "$init/bin/run"
(cd "$init" && find . | cpio -o -H newc --quiet | gzip -1 >"$work/iso/initrd.gz")
cp "$cache/vmlinuz" "$work/iso/vmlinuz"
cp /usr/lib/ISOLINUX/isolinux.bin /usr/lib/syslinux/modules/bios/ldlinux.c32 "$work/iso/isolinux/"
# Bochs and Linux compute different sizes of the compact XSAVE area, and Linux then disables AVX: xsavec and xsaves (321, 323) are hidden from it.
cat >"$work/iso/isolinux/isolinux.cfg" <<'CFG'
default run
prompt 0
timeout 0
label run
 kernel /vmlinuz
 append initrd=/initrd.gz console=ttyS0,115200 rdinit=/init clearcpuid=321,323 nokaslr mitigations=off nosmp noapic tsc=unstable clocksource=pit lpj=1000000 loglevel=3 panic=-1
CFG
xorriso -as mkisofs -quiet -o "$work/boot.iso" -b isolinux/isolinux.bin -c isolinux/boot.cat -no-emul-boot -boot-load-size 4 \
  -boot-info-table "$work/iso" 2>/dev/null
cat >"$work/bochsrc" <<CFG
config_interface: textconfig
display_library: term
cpu: model=corei7_skylake_x, count=1, ips=30000000, reset_on_triple_fault=0
memory: guest=1024, host=1024
romimage: file=/usr/share/bochs/BIOS-bochs-latest
vgaromimage: file=/usr/share/vgabios/vgabios.bin
ata0: enabled=1, ioaddr1=0x1f0, ioaddr2=0x3f0, irq=14
ata0-master: type=cdrom, path=$work/boot.iso, status=inserted
boot: cdrom
com1: enabled=1, mode=file, dev=$work/serial
clock: sync=none
speaker: enabled=0
sound: driver=dummy
log: $work/log
logprefix: %t%e%d
panic: action=fatal
error: action=ignore
info: action=ignore
CFG
echo c >"$work/rc"   # Debian's build has a debugger that waits for "continue".
: >"$work/serial"
TERM=xterm timeout "$limit" script -qfec "bochs -q -rc $work/rc -f $work/bochsrc" /dev/null </dev/null >"$work/screen" 2>&1 || true

tr -d '\r' <"$work/serial" | sed -n '/^@begin$/,/^@exit /{/^@/d;p}'
grep -q '^@flags .*avx512f .*avx512dq .*avx512bw .*avx512vl' "$work/serial" || { echo "avx512: the emulated CPU did not come up" >&2; tail -n 5 "$work/log" "$work/serial" >&2; exit 1; }
status=$(tr -d '\r' <"$work/serial" | sed -n 's/^@exit //p')
[ -n "$status" ] || { echo "avx512: no end within $limit s" >&2; exit 1; }
exit "$status"
