//! SM3 (GB/T 32905-2016) as a running hash, for data in several pieces. One-shot hashes go through the provider.

use zeroize::ZeroizeOnDrop;

use super::kernel::{BLOCK, INITIAL, compress, ending};

/// A running SM3 hash.
#[derive(Clone, ZeroizeOnDrop)]
pub struct Sm3Hasher {
    state: [u32; 8],
    /// Bytes hashed so far.
    length: u64,
    /// The last of them, which do not fill a block.
    waiting: [u8; BLOCK],
    filled: usize,
}

impl Default for Sm3Hasher {
    fn default() -> Self {
        Self { state: INITIAL, length: 0, waiting: [0; BLOCK], filled: 0 }
    }
}

impl Sm3Hasher {
    /// Of no bytes yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds bytes.
    pub fn update(&mut self, mut bytes: &[u8]) {
        self.length = self.length.wrapping_add(bytes.len() as u64);
        if self.filled > 0 {
            let (taken, rest) = bytes.split_at(bytes.len().min(BLOCK - self.filled));
            self.waiting[self.filled..self.filled + taken.len()].copy_from_slice(taken);
            self.filled += taken.len();
            if self.filled < BLOCK {
                return;
            }
            compress(&mut self.state, &[self.waiting]);
            bytes = rest;
        }
        let (blocks, rest) = bytes.as_chunks();
        compress(&mut self.state, blocks);
        self.waiting[..rest.len()].copy_from_slice(rest);
        self.filled = rest.len();
    }

    /// The hash of all bytes added.
    pub fn finish(mut self) -> [u8; 32] {
        let (end, count) = ending(&self.waiting[..self.filled], self.length);
        compress(&mut self.state, &end[..count]);
        let mut hash = [0; 32];
        for (bytes, word) in hash.as_chunks_mut::<4>().0.iter_mut().zip(self.state) {
            *bytes = word.to_be_bytes();
        }
        hash
    }
}

impl std::io::Write for Sm3Hasher {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// SM3 of the concatenation of `parts`.
pub fn sm3(parts: &[&[u8]]) -> [u8; 32] {
    let mut hasher = Sm3Hasher::new();
    for part in parts {
        hasher.update(part);
    }
    hasher.finish()
}

/// SM3 of each message, in order: up to 16 side by side if the processor has the vectors for it.
pub fn sm3_many(messages: &[&[u8]]) -> Vec<[u8; 32]> {
    super::kernel::digest_many(messages)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::sm3::{Digest as _, Sm3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pieces_do_not_matter(
            data in proptest::collection::vec(any::<u8>(), 0..9000),
            cuts in proptest::collection::vec(0usize..9000, 0..6),
        ) {
            let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.min(data.len())).collect();
            cuts.sort_unstable();
            let (mut hasher, mut from) = (Sm3Hasher::new(), 0);
            for to in cuts.into_iter().chain([data.len()]) {
                hasher.update(&data[from..to]);
                from = to;
            }
            let by_crate: [u8; 32] = Sm3::digest(&data).into();
            prop_assert_eq!(hasher.finish(), by_crate);
        }
    }
}
