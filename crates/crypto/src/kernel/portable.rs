//! SM4 on any processor, bitsliced: bit b of word w of 64 blocks lies in one number, and a round is a circuit of AND
//! and XOR. No tables and no branches, so the time depends on neither key nor data.
//! The inverse in GF(2^8) is computed in GF(2^4)[Y] / (Y^2 + Y + x^3), GF(2^4) = GF(2)[x] / (x^4 + x + 1).

#![allow(clippy::inline_always, reason = "one circuit: the compiler must see the constants of its maps")]

use zeroize::Zeroize as _;

use super::Counter;
use super::sbox::{CONSTANT_AFTER, CONSTANT_BEFORE, MATRIX_AFTER, MATRIX_BEFORE, product, round_keys};

const BATCH: usize = 1024;
/// One byte in each of 64 blocks, bit by bit.
type Byte = [u64; 8];
type Nibble = [u64; 4];
type Word = [u64; 32];

/// Into the tower field, after the first affine map: rows, and the constant.
const INTO: ([u8; 8], u8) = (rows_into(), to_tower(CONSTANT_BEFORE));
/// Out of the tower field, before the second.
const OUT_OF: ([u8; 8], u8) = (rows_out_of(), CONSTANT_AFTER);

const fn nibble_product(left: u8, right: u8) -> u8 {
    let (mut sum, mut bit) = (0, 0);
    while bit < 4 {
        if right >> bit & 1 == 1 {
            sum ^= left << bit;
        }
        bit += 1;
    }
    while bit > 0 {
        bit -= 1;
        if sum >> (4 + bit) & 1 == 1 {
            sum ^= 0b1_0011 << bit;
        }
    }
    sum
}

/// A product in the tower; the upper half is the factor of Y.
const fn tower_product(left: u8, right: u8) -> u8 {
    let (a, b, c, d) = (left >> 4, left & 15, right >> 4, right & 15);
    let squares = nibble_product(a, c);
    let high = squares ^ nibble_product(a, d) ^ nibble_product(b, c);
    let low = nibble_product(squares, 8) ^ nibble_product(b, d);
    high << 4 | low
}

/// An element that solves AES's x^8 + x^4 + x^3 + x + 1 = 0 in the tower: the image of x.
const fn root() -> u8 {
    let mut candidate = 2;
    loop {
        let square = tower_product(candidate, candidate);
        let cube = tower_product(square, candidate);
        let fourth = tower_product(square, square);
        if tower_product(fourth, fourth) ^ fourth ^ cube ^ candidate ^ 1 == 0 {
            return candidate;
        }
        candidate += 1;
    }
}

/// The powers of that element: the images of 1, x, x^2, ...
const POWERS: [u8; 8] = {
    let (root, mut powers, mut bit) = (root(), [1; 8], 1);
    while bit < 8 {
        powers[bit] = tower_product(powers[bit - 1], root);
        bit += 1;
    }
    powers
};

const fn to_tower(byte: u8) -> u8 {
    let (mut sum, mut bit) = (0, 0);
    while bit < 8 {
        if byte >> bit & 1 == 1 {
            sum ^= POWERS[bit];
        }
        bit += 1;
    }
    sum
}

/// Puts the image of bit `bit` into the rows of a matrix.
const fn with_column(mut rows: [u8; 8], bit: usize, image: u8) -> [u8; 8] {
    let mut row = 0;
    while row < 8 {
        rows[row] |= (image >> row & 1) << bit;
        row += 1;
    }
    rows
}

const fn rows_into() -> [u8; 8] {
    let (mut rows, mut bit) = ([0; 8], 0);
    while bit < 8 {
        rows = with_column(rows, bit, to_tower(product(MATRIX_BEFORE, 1 << bit)));
        bit += 1;
    }
    rows
}

const fn rows_out_of() -> [u8; 8] {
    let (mut rows, mut bit) = ([0; 8], 0);
    while bit < 8 {
        let mut byte = 0u8;
        while to_tower(byte) != 1 << bit {
            byte += 1;
        }
        rows = with_column(rows, bit, product(MATRIX_AFTER, byte));
        bit += 1;
    }
    rows
}

#[inline(always)]
fn mapped((rows, constant): ([u8; 8], u8), byte: &Byte) -> Byte {
    let mut out = [0; 8];
    for (bit, out) in out.iter_mut().enumerate() {
        *out = 0u64.wrapping_sub(u64::from(constant >> bit & 1));
        for (from, plane) in byte.iter().enumerate() {
            if rows[bit] >> from & 1 == 1 {
                *out ^= plane;
            }
        }
    }
    out
}

#[inline(always)]
fn times(a: Nibble, b: Nibble) -> Nibble {
    let fourth = a[1] & b[3] ^ a[2] & b[2] ^ a[3] & b[1];
    let fifth = a[2] & b[3] ^ a[3] & b[2];
    let sixth = a[3] & b[3];
    [
        a[0] & b[0] ^ fourth,
        a[0] & b[1] ^ a[1] & b[0] ^ fourth ^ fifth,
        a[0] & b[2] ^ a[1] & b[1] ^ a[2] & b[0] ^ fifth ^ sixth,
        a[0] & b[3] ^ a[1] & b[2] ^ a[2] & b[1] ^ a[3] & b[0] ^ sixth,
    ]
}

#[inline(always)]
fn square(a: Nibble) -> Nibble {
    [a[0] ^ a[2], a[2], a[1] ^ a[3], a[3]]
}

#[inline(always)]
fn sum(a: Nibble, b: Nibble) -> Nibble {
    [a[0] ^ b[0], a[1] ^ b[1], a[2] ^ b[2], a[3] ^ b[3]]
}

/// a^14, which is the inverse; 0 stays 0.
#[inline(always)]
fn inverse(a: Nibble) -> Nibble {
    let second = square(a);
    let fourth = square(second);
    times(times(second, fourth), square(fourth))
}

#[inline(always)]
fn substituted(byte: &Byte) -> Byte {
    let [l0, l1, l2, l3, h0, h1, h2, h3] = mapped(INTO, byte);
    let (high, low) = ([h0, h1, h2, h3], [l0, l1, l2, l3]);
    let both = sum(high, low);
    let norm = sum(times(low, both), times(square(high), [0, 0, 0, u64::MAX]));
    let norm = inverse(norm);
    let ([h0, h1, h2, h3], [l0, l1, l2, l3]) = (times(high, norm), times(both, norm));
    mapped(OUT_OF, &[l0, l1, l2, l3, h0, h1, h2, h3])
}

/// One round: the word to replace, and the other three.
#[inline]
fn round(word: &mut Word, others: [&Word; 3], key: u32) {
    let mut bytes = [0; 32];
    for (bit, out) in bytes.iter_mut().enumerate() {
        *out = others[0][bit] ^ others[1][bit] ^ others[2][bit] ^ plane(key, bit);
    }
    for byte in bytes.as_chunks_mut::<8>().0 {
        *byte = substituted(byte);
    }
    for (bit, out) in word.iter_mut().enumerate() {
        let turned = |by: usize| bytes[(bit + 32 - by) % 32];
        *out ^= bytes[bit] ^ turned(2) ^ turned(10) ^ turned(18) ^ turned(24);
    }
}

/// Bit `bit` of a word that is the same in all blocks.
#[inline(always)]
fn plane(word: u32, bit: usize) -> u64 {
    0u64.wrapping_sub(u64::from(word >> bit & 1))
}

fn transpose(rows: &mut [u64; 64]) {
    let (mut step, mut mask) = (32, 0xffff_ffff_u64);
    while step > 0 {
        let mut row = 0;
        while row < 64 {
            let swapped = (rows[row] >> step ^ rows[row + step]) & mask;
            rows[row] ^= swapped << step;
            rows[row + step] ^= swapped;
            row = (row + step + 1) & !step;
        }
        step >>= 1;
        mask ^= mask << step;
    }
}

/// The counter blocks of `counter` and the 63 after it; if `zero`, the first one is all zeros.
fn counters(counter: Counter, zero: bool) -> [Word; 4] {
    let first = if zero { !1 } else { u64::MAX };
    let mut words = [[0; 32]; 4];
    for (word, value) in words.iter_mut().zip(counter.nonce) {
        for (bit, out) in word.iter_mut().enumerate() {
            *out = plane(value, bit) & first;
        }
    }
    let mut rows = [0; 64];
    for (block, row) in (0..64u32).zip(&mut rows) {
        *row = u64::from(counter.number.wrapping_add(block));
    }
    transpose(&mut rows);
    words[3].copy_from_slice(&rows[..32]);
    words
}

fn stream(keys: &[u32; 32], counter: Counter, zero: bool) -> [u8; BATCH] {
    let [mut a, mut b, mut c, mut d] = counters(counter, zero);
    for &[first, second, third, fourth] in keys.as_chunks::<4>().0 {
        round(&mut a, [&b, &c, &d], first);
        round(&mut b, [&c, &d, &a], second);
        round(&mut c, [&d, &a, &b], third);
        round(&mut d, [&a, &b, &c], fourth);
    }
    let mut out = [0; BATCH];
    // The last word of the state is the first of the block.
    for (half, (low, high)) in [(c, d), (a, b)].into_iter().enumerate() {
        let mut rows = [0; 64];
        rows[..32].copy_from_slice(&low);
        rows[32..].copy_from_slice(&high);
        transpose(&mut rows);
        for (block, row) in out.as_chunks_mut::<16>().0.iter_mut().zip(&rows) {
            block[half * 8..half * 8 + 8].copy_from_slice(&row.to_be_bytes());
        }
        rows.zeroize();
    }
    for word in [&mut a, &mut b, &mut c, &mut d] {
        word.zeroize();
    }
    out
}

pub(super) fn expand(key: &[u8; 16]) -> [u32; 32] {
    round_keys(key, |word| {
        let mut byte = [0; 8];
        for (bit, plane) in byte.iter_mut().enumerate() {
            *plane = u64::from(word >> bit & 0x0101_0101);
        }
        let planes = substituted(&byte);
        let bits = planes.iter().enumerate().map(|(bit, plane)| (plane & 0x0101_0101) << bit);
        let [first, second, third, fourth, ..] = bits.fold(0, |sum, bits| sum | bits).to_le_bytes();
        u32::from_le_bytes([first, second, third, fourth])
    })
}

pub(super) fn apply(keys: &[u32; 32], mut counter: Counter, text: &mut [u8]) {
    for part in text.chunks_mut(BATCH) {
        let mut stream = stream(keys, counter, false);
        part.iter_mut().zip(&stream).for_each(|(byte, mask)| *byte ^= mask);
        counter.number = counter.number.wrapping_add(64);
        stream.zeroize();
    }
}

/// The first 16 blocks of a nonce: E(0), E(J0), then the stream.
pub(super) fn first(keys: &[u32; 32], nonce: [u32; 3]) -> [u8; 256] {
    let mut stream = stream(keys, Counter { nonce, number: 0 }, true);
    let out = std::array::from_fn(|at| stream[at]);
    stream.zeroize();
    out
}
