#!/usr/bin/env bash
# Package: zip 9.8.1 (crates.io), on an archive of the form that torch.save of PyTorch 2.15 writes: stored entries, then the records of 64 bits, which no field
#   of the end record requires.
# Behaviour: `ZipArchive::new` fails where the first entry's name has 30 bytes (`data.pkl` in a folder named by 21 characters, after the file). The crate
#   expects the directory right before the end record, 76 bytes (the two records of 64 bits) after its true start. With a name of 30 bytes the second entry begins
#   there and is taken for the first. With any other length no entry begins there, and the offset in the end record is used. `with_config` with
#   `ArchiveOffset::Known(0)` reads both, and so do Python's zipfile and PyTorch.
# Guess beforehand: the length of a name does not matter.
# Output seen:
#   name of 29 bytes: zip reads 2 files, with Known(0) 2, Python 2
#   name of 30 bytes: zip reads invalid Zip archive: Invalid Central Directory header, with Known(0) 2, Python 2
# Consequence: a reader of PyTorch's files by this crate must pass the archive's offset.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cargo init --quiet --vcs none --name reads .
cargo add --quiet zip@=9.8.1 --no-default-features
cat >src/main.rs <<'END'
use std::io::Cursor;
use zip::ZipArchive;
use zip::read::{ArchiveOffset, Config};

fn main() {
    let bytes = std::fs::read(std::env::args().nth(1).unwrap()).unwrap();
    let plain = ZipArchive::new(Cursor::new(&bytes)).map(|archive| format!("{} files", archive.len()));
    let config = Config { archive_offset: ArchiveOffset::Known(0) };
    let known = ZipArchive::with_config(config, Cursor::new(&bytes)).unwrap();
    print!("zip reads {}, with Known(0) {}", plain.unwrap_or_else(|e| e.to_string()), known.len());
}
END
cargo build --quiet --release 2>/dev/null
cat >make.py <<'END'
import io, struct, sys, zipfile

length = int(sys.argv[1])
memory = io.BytesIO()
with zipfile.ZipFile(memory, 'w') as archive:
    archive.writestr('x' * (length - 9) + '/data.pkl', b'pickle')
    archive.writestr('x' * (length - 9) + '/version', b'3\n')
whole = memory.getvalue()
end = whole.rindex(b'PK\5\6')
files, size, start = struct.unpack('<10xHII', whole[end:end + 20])
records = struct.pack('<4sQHHIIQQQQ', b'PK\6\6', 44, 0x31e, 45, 0, 0, files, files, size, start) + struct.pack('<4sIQI', b'PK\6\7', 0, end, 1)
open('it.zip', 'wb').write(whole[:end] + records + whole[end:])
END
found=
for length in 29 30; do
  python3 make.py $length
  python=$(python3 -c 'import zipfile; z = zipfile.ZipFile("it.zip"); assert z.testzip() is None; print(len(z.namelist()))')
  found+="name of $length bytes: $(target/release/reads it.zip), Python $python"$'\n'
done
printf '%s' "$found"
[ "$found" = 'name of 29 bytes: zip reads 2 files, with Known(0) 2, Python 2
name of 30 bytes: zip reads invalid Zip archive: Invalid Central Directory header, with Known(0) 2, Python 2
' ]
