//! Stable radix sort of a tile's list by depth.

/// An entry of a tile's list: the bits of a positive depth, and the Gaussian's index.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub(super) struct Entry {
    pub key: u32,
    pub index: u32,
}

/// Lists up to this long are sorted by insertion.
const SHORT: usize = 24;
/// Bits of a key per pass.
const DIGIT: u32 = 9;
const MASK: u32 = (1 << DIGIT) - 1;

/// Sorts `list` by key, keeping the order of equal keys (lower index first, as lists are filled in index order).
///
/// `spare` is scratch of any length.
pub(super) fn by_depth(list: &mut [Entry], spare: &mut Vec<Entry>) {
    if list.len() <= SHORT {
        for i in 1..list.len() {
            let entry = list[i];
            let mut j = i;
            while j > 0 && list[j - 1].key > entry.key {
                list[j] = list[j - 1];
                j -= 1;
            }
            list[j] = entry;
        }
        return;
    }
    let (mut least, mut most, mut ordered, mut last) = (u32::MAX, 0, true, 0);
    for entry in list.iter() {
        ordered &= last <= entry.key;
        last = entry.key;
        least = least.min(entry.key);
        most = most.max(entry.key);
    }
    if ordered {
        return;
    }
    let passes = (32 - (most - least).leading_zeros()).div_ceil(DIGIT) as usize;
    let mut counts = [[0_u32; 1 << DIGIT]; 4];
    for entry in list.iter() {
        let key = entry.key - least;
        for (pass, count) in counts.iter_mut().enumerate().take(passes) {
            count[(key >> (DIGIT * pass as u32) & MASK) as usize] += 1;
        }
    }
    if spare.len() < list.len() {
        spare.resize(list.len(), Entry::default());
    }
    let other = &mut spare[..list.len()];
    for (pass, count) in counts.iter_mut().enumerate().take(passes) {
        let mut start = 0;
        for slot in count.iter_mut() {
            start += std::mem::replace(slot, start);
        }
        let shift = DIGIT * pass as u32;
        let (from, to): (&[Entry], &mut [Entry]) = if pass % 2 == 0 { (list, other) } else { (other, list) };
        for entry in from {
            let slot = &mut count[((entry.key - least) >> shift & MASK) as usize];
            to[*slot as usize] = *entry;
            *slot += 1;
        }
    }
    if passes % 2 == 1 {
        list.copy_from_slice(other);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_stable_sort_of_the_standard_library() {
        let mut state = 7_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 4
        };
        let mut spare = Vec::new();
        for len in [0, 1, 2, 23, 24, 25, 100, 1000, 4097] {
            for mask in [0, 3, 0xff, 0x1ff, 0xffff, 0x00ff_ffff, u32::MAX] {
                let mut list: Vec<Entry> =
                    (0..len).map(|index| Entry { key: 0x3f00_0000 ^ (random() & mask), index }).collect();
                let mut expected = list.clone();
                expected.sort_by_key(|entry| entry.key);
                by_depth(&mut list, &mut spare);
                assert_eq!(list, expected, "{len} keys, mask {mask:x}");
            }
        }
    }
}
