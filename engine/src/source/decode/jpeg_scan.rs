//! Check that the Huffman codes of a baseline JPEG image cover the whole picture.
//!
//! The decoder of pictures accepts damaged data: it stops at a block's last coefficient and leaves missing parts grey.
//! This module reads the Huffman codes once more (ITU-T T.81, F.2.2), without their values. It rejects invalid codes,
//! runs past the 63rd coefficient, missing restart markers, and data that end before the last block. Extra bytes after
//! that block are accepted, because cameras write them. Damage that leaves valid codes for the same number of blocks is
//! not detected. Progressive and arithmetic-coded images are not checked.

/// The marker that ends an image.
pub(super) const END: u8 = 0xd9;
/// Bits of a table look-up.
const QUICK: u32 = 9;
/// Maximum length of a code, in bits.
const LONGEST: usize = 16;

/// A Huffman table. `quick` has length and symbol for each [`QUICK`]-bit prefix, 0 where the code is longer.
struct Table {
    quick: Vec<(u8, u8)>,
    /// For each length: the offset from a code to the index of its symbol, and the first number that is no code.
    lengths: [(i32, i32); LONGEST + 1],
    symbols: Vec<u8>,
}

impl Table {
    /// Builds a table from the number of codes of each length, 1 to 16, and the symbols in the order of the codes.
    fn new(counts: &[u8], symbols: &[u8]) -> Table {
        let mut table =
            Table { quick: vec![(0, 0); 1 << QUICK], lengths: [(0, 0); LONGEST + 1], symbols: symbols.to_vec() };
        let (mut code, mut at) = (0_i32, 0_usize);
        for (length, &count) in (1..=LONGEST).zip(counts) {
            for _ in 0..count {
                if let (Some(&symbol), Some(spare)) = (symbols.get(at), QUICK.checked_sub(length as u32)) {
                    let from = (code as usize) << spare;
                    let slots = table.quick.iter_mut().skip(from).take(1 << spare);
                    slots.for_each(|slot| *slot = (length as u8, symbol));
                }
                (code, at) = (code + 1, at + 1);
            }
            table.lengths[length] = (at as i32 - code, code);
            code <<= 1;
        }
        table
    }
}

/// Bits of a scan, most significant first. A zero byte after 0xff is skipped; any other byte after 0xff is a marker,
/// which ends the bits.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    bits: u64,
    count: u32,
}

impl Bits<'_> {
    /// Reads ahead to at least 16 bits, unless the data end.
    fn fill(&mut self) {
        while self.count <= 48 {
            let Some(&byte) = self.bytes.get(self.at) else { return };
            if byte == 0xff {
                if self.bytes.get(self.at + 1) != Some(&0) {
                    return;
                }
                self.at += 1;
            }
            self.at += 1;
            self.bits = self.bits << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    /// Returns the next `count` bits without consuming them, padded with zeros at the end of the data.
    fn peek(&self, count: u32) -> u32 {
        let bits =
            if self.count >= count { self.bits >> (self.count - count) } else { self.bits << (count - self.count) };
        bits as u32 & ((1 << count) - 1)
    }

    fn skip(&mut self, count: u32) -> Result<(), Fault> {
        self.count = self.count.checked_sub(count).ok_or(Fault::End)?;
        Ok(())
    }

    fn symbol(&mut self, table: &Table) -> Result<u8, Fault> {
        self.fill();
        let (length, symbol) = table.quick[self.peek(QUICK) as usize];
        if length > 0 {
            self.skip(u32::from(length))?;
            return Ok(symbol);
        }
        let word = self.peek(LONGEST as u32) as i32;
        for length in QUICK as usize + 1..=LONGEST {
            let code = word >> (LONGEST - length);
            let (offset, end) = table.lengths[length];
            if code < end {
                self.skip(length as u32)?;
                return table.symbols.get((code + offset) as usize).copied().ok_or(Fault::Code);
            }
        }
        // Bits after the data are not codes.
        Err(if self.count < LONGEST as u32 { Fault::End } else { Fault::Code })
    }

    /// Skips the rest of a byte and reads the restart marker that follows.
    fn restart(&mut self) -> Result<(), Fault> {
        (self.bits, self.count) = (0, 0);
        while self.bytes.get(self.at) == Some(&0xff) {
            self.at += 1;
        }
        match self.bytes.get(self.at) {
            Some(0xd0..=0xd7) if self.bytes.get(self.at - 1) == Some(&0xff) => self.at += 1,
            _ => return Err(Fault::Restart),
        }
        Ok(())
    }
}

enum Fault {
    /// An invalid code.
    Code,
    /// A run past the last coefficient.
    Run,
    /// A missing restart marker.
    Restart,
    /// The end of the data.
    End,
}

struct Component {
    id: u8,
    across: usize,
    down: usize,
}

/// Tables by their numbers, 0 to 3.
type Tables = [Option<Table>; 4];

/// Checks every scan of the first image in a file.
pub(super) fn check(bytes: &[u8]) -> Result<(), String> {
    let (mut dc, mut ac): (Tables, Tables) = Default::default();
    let mut frame: Option<((usize, usize), Vec<Component>)> = None;
    let mut interval = 0;
    let mut at = 2;
    // The decoder reports unknown headers.
    while let Some((marker, body)) = segment(bytes, &mut at) {
        match marker {
            0xc0 | 0xc1 => frame = components(body),
            0xc4 => tables(body, &mut dc, &mut ac),
            0xdd => interval = body.get(..2).map_or(0, |b| usize::from(u16::from_be_bytes([b[0], b[1]]))),
            0xda => {
                let Some((size, all)) = &frame else { return Ok(()) };
                let Some(blocks) = scan(body, *size, all, &dc, &ac) else { return Ok(()) };
                let mut bits = Bits { bytes, at, bits: 0, count: 0 };
                codes(&mut bits, &blocks, interval)?;
                at = bits.at;
            }
            // Other codings, and the end of the image.
            0xc2..=0xcf if marker != 0xc8 && marker != 0xcc => return Ok(()),
            END => return Ok(()),
            _ => {}
        }
    }
    Ok(())
}

/// Returns the next marker with its body. Bytes before the marker are skipped.
pub(super) fn segment<'a>(bytes: &'a [u8], at: &mut usize) -> Option<(u8, &'a [u8])> {
    loop {
        *at += bytes.get(*at..)?.iter().position(|&b| b == 0xff)?;
        while bytes.get(*at) == Some(&0xff) {
            *at += 1;
        }
        let marker = *bytes.get(*at)?;
        *at += 1;
        match marker {
            0x00 | 0x01 | 0xd0..=0xd8 => {}
            END => return Some((marker, &[])),
            _ => {
                let length = usize::from(u16::from_be_bytes(*bytes.get(*at..)?.first_chunk()?)).max(2);
                let body = bytes.get(*at + 2..*at + length)?;
                *at += length;
                return Some((marker, body));
            }
        }
    }
}

/// Parses width, height and components of a frame header with 8-bit samples and a stated height.
fn components(body: &[u8]) -> Option<((usize, usize), Vec<Component>)> {
    let [8, h0, h1, w0, w1, count, rest @ ..] = body else { return None };
    let size = [[*w0, *w1], [*h0, *h1]].map(|pair| usize::from(u16::from_be_bytes(pair)));
    let (all, _) = rest.as_chunks::<3>();
    let all: Vec<Component> = all
        .iter()
        .take(usize::from(*count))
        .map(|&[id, sampling, _]| Component {
            id,
            across: usize::from(sampling >> 4),
            down: usize::from(sampling & 15),
        })
        .collect();
    let valid = all.iter().all(|c| (1..=4).contains(&c.across) && (1..=4).contains(&c.down));
    (valid && size[0] > 0 && size[1] > 0 && all.len() == usize::from(*count)).then_some(((size[0], size[1]), all))
}

fn tables(mut body: &[u8], dc: &mut Tables, ac: &mut Tables) {
    while let Some((&kind, rest)) = body.split_first() {
        let Some((counts, rest)) = rest.split_at_checked(LONGEST) else { return };
        let number: usize = counts.iter().map(|&count| usize::from(count)).sum();
        let Some((symbols, rest)) = rest.split_at_checked(number) else { return };
        let class = if kind >> 4 == 0 { &mut *dc } else { &mut *ac };
        if let Some(place) = class.get_mut(usize::from(kind & 15)) {
            *place = Some(Table::new(counts, symbols));
        }
        body = rest;
    }
}

/// The blocks of a scan: the number of units, and the tables of each block of a unit.
struct Blocks<'a> {
    units: usize,
    unit: Vec<(&'a Table, &'a Table)>,
}

fn scan<'a>(
    body: &[u8],
    (width, height): (usize, usize),
    all: &[Component],
    dc: &'a Tables,
    ac: &'a Tables,
) -> Option<Blocks<'a>> {
    let (&count, rest) = body.split_first()?;
    let (chosen, _) = rest.as_chunks::<2>();
    let chosen = chosen.get(..usize::from(count))?;
    let most = |of: fn(&Component) -> usize| all.iter().map(of).max();
    let (across, down) = (most(|c| c.across)?, most(|c| c.down)?);
    let mut unit = Vec::new();
    let mut units = width.div_ceil(8 * across) * height.div_ceil(8 * down);
    for [id, which] in chosen {
        let component = all.iter().find(|component| component.id == *id)?;
        let table = |tables: &'a Tables, number: u8| tables.get(usize::from(number))?.as_ref();
        let pair = (table(dc, which >> 4)?, table(ac, which & 15)?);
        let blocks = if let [_] = chosen {
            // A scan of one component has only the blocks that its samples fill.
            let samples = |size: usize, own: usize, most: usize| (size * own).div_ceil(most).div_ceil(8);
            units = samples(width, component.across, across) * samples(height, component.down, down);
            1
        } else {
            component.across * component.down
        };
        unit.extend(std::iter::repeat_n(pair, blocks));
    }
    Some(Blocks { units, unit })
}

fn codes(bits: &mut Bits<'_>, blocks: &Blocks<'_>, interval: usize) -> Result<(), String> {
    for index in 0..blocks.units {
        let mut read = || {
            if interval > 0 && index > 0 && index % interval == 0 {
                bits.restart()?;
            }
            blocks.unit.iter().try_for_each(|(dc, ac)| block(bits, dc, ac))
        };
        if let Err(fault) = read() {
            let cause = match fault {
                Fault::Code => "expected a code of its tables, found none",
                Fault::Run => "expected at most 63 coefficients in a block, found more",
                Fault::Restart => "expected a restart marker, found none",
                Fault::End => "expected more data, found their end",
            };
            return Err(format!("the JPEG image is damaged at unit {index} of {}: {cause}", blocks.units));
        }
    }
    Ok(())
}

fn block(bits: &mut Bits<'_>, dc: &Table, ac: &Table) -> Result<(), Fault> {
    let size = bits.symbol(dc)?;
    if size > 11 {
        return Err(Fault::Code);
    }
    bits.skip(u32::from(size))?;
    let mut at = 1;
    while at < 64 {
        let symbol = bits.symbol(ac)?;
        let (run, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
        match (run, size) {
            (0, 0) => break,
            (15, 0) => at += 16,
            (_, 0) => return Err(Fault::Code),
            _ => {
                at += run + 1;
                bits.skip(size)?;
            }
        }
    }
    if at > 64 { Err(Fault::Run) } else { Ok(()) }
}
