//! The parts of SM4 (GB/T 32907-2016) that all kernels share: its S-box as an affine map, the inverse in GF(2^8) with
//! AES's polynomial, and another affine map; its key schedule. No table is ever indexed by a secret.

use zeroize::Zeroize as _;

/// The matrix before the inverse, in the form `gf2p8affineqb` takes.
pub(super) const MATRIX_BEFORE: u64 = 0x4c28_7db9_1a22_505d;
pub(super) const CONSTANT_BEFORE: u8 = 0x3e;
pub(super) const MATRIX_AFTER: u64 = 0xf3ab_34a9_74a6_b589;
pub(super) const CONSTANT_AFTER: u8 = 0xd3;

/// FK, which is XORed with the key.
const SYSTEM: [u32; 4] = [0xa3b1_bac6, 0x56aa_3350, 0x677d_9197, 0xb270_22dc];

/// A byte times a matrix: the most significant byte is the row of bit 0, as in the instruction.
pub(super) const fn product(matrix: u64, byte: u8) -> u8 {
    let rows = matrix.to_be_bytes();
    let (mut out, mut bit) = (0u8, 0);
    while bit < 8 {
        if (rows[bit] & byte).count_ones() % 2 == 1 {
            out |= 1 << bit;
        }
        bit += 1;
    }
    out
}

/// CK of a round: the bytes 7 (4 round + j), modulo 256.
#[inline]
const fn constant(round: u8) -> u32 {
    let first = round.wrapping_mul(28);
    u32::from_be_bytes([first, first.wrapping_add(7), first.wrapping_add(14), first.wrapping_add(21)])
}

/// The key schedule (6.3); `substituted` applies the S-box to each byte of a word.
#[inline(always)]
#[allow(clippy::inline_always, reason = "the S-box may need features that only the caller has")]
pub(super) fn round_keys(key: &[u8; 16], substituted: impl Fn(u32) -> u32) -> [u32; 32] {
    let mut words = SYSTEM;
    for (word, bytes) in words.iter_mut().zip(key.as_chunks::<4>().0) {
        *word ^= u32::from_be_bytes(*bytes);
    }
    let mut keys = [0; 32];
    for (round, key) in (0..32u8).zip(&mut keys) {
        let [first, second, third, fourth] = words;
        let bytes = substituted(second ^ third ^ fourth ^ constant(round));
        *key = first ^ bytes ^ bytes.rotate_left(13) ^ bytes.rotate_left(23);
        words = [second, third, fourth, *key];
    }
    words.zeroize();
    keys
}
