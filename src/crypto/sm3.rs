//! SM3 (GB/T 32905-2016) as a running hash, for data that does not lie in one piece.
//! One-shot hashes go through the provider.

use sm3::{Digest as _, Sm3};

/// A running SM3 hash.
#[derive(Clone, Default)]
pub struct Sm3Hasher(Sm3);

impl Sm3Hasher {
    /// Of nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes in more bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The hash of all bytes taken in.
    pub fn finish(self) -> [u8; 32] {
        self.0.finalize().into()
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

/// SM3 of each message, in their order: up to 16 side by side where the processor has the vectors for it.
pub fn sm3_many(messages: &[&[u8]]) -> Vec<[u8; 32]> {
    super::kernel::digest_many(messages)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pieces_do_not_matter(data in proptest::collection::vec(any::<u8>(), 0..500), cut in 0usize..500) {
            let cut = cut.min(data.len());
            let mut hasher = Sm3Hasher::new();
            hasher.update(&data[..cut]);
            hasher.update(&data[cut..]);
            prop_assert_eq!(hasher.finish(), sm3(&[&data]));
        }
    }
}
