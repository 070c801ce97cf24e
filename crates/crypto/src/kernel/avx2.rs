//! SM4 on 32 blocks at once with AVX2, where each kernel supplies its own S-box, and what all vector kernels share.
//! Safety: the features are checked before [`super`] calls; the only memory access goes through references to whole
//! arrays of 32 bytes, unaligned.
#![allow(unsafe_code, reason = "vector loads and stores, see above")]

use std::arch::x86_64::*;

use super::Counter;

/// Bytes in one group: 8 blocks.
pub(super) const GROUP: usize = 128;

/// Words of 8 blocks, word by word.
pub(super) type Group = [__m256i; 4];

/// Each word rotated left by a whole number of bytes, or with its bytes reversed.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn shuffled(words: __m256i, order: __m128i) -> __m256i {
    _mm256_shuffle_epi8(words, _mm256_broadcastsi128_si256(order))
}

/// The substituted bytes before they are added: L of GB/T 32907, 6.2.2.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn diffused(word: __m256i, bytes: __m256i) -> __m256i {
    let eight = shuffled(bytes, _mm_setr_epi8(3, 0, 1, 2, 7, 4, 5, 6, 11, 8, 9, 10, 15, 12, 13, 14));
    let sixteen = shuffled(bytes, _mm_setr_epi8(2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13));
    let twenty_four = shuffled(bytes, _mm_setr_epi8(1, 2, 3, 0, 5, 6, 7, 4, 9, 10, 11, 8, 13, 14, 15, 12));
    let three = _mm256_xor_si256(bytes, _mm256_xor_si256(eight, sixteen));
    let turned = _mm256_or_si256(_mm256_slli_epi32::<2>(three), _mm256_srli_epi32::<30>(three));
    let rest = _mm256_xor_si256(word, _mm256_xor_si256(bytes, twenty_four));
    _mm256_xor_si256(rest, turned)
}

/// The sum that goes through the S-box.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn mixed([one, two, three]: [__m256i; 3], key: __m256i) -> __m256i {
    _mm256_xor_si256(_mm256_xor_si256(one, two), _mm256_xor_si256(three, key))
}

/// 8 counter blocks from `number` on, laid out so that [`add_group`] needs no exchange between lanes.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn counters(counter: Counter) -> Group {
    let dealt = _mm256_setr_epi32(0, 2, 4, 6, 1, 3, 5, 7);
    let [first, second, third] = counter.nonce.map(|word| word.cast_signed());
    [
        _mm256_set1_epi32(first),
        _mm256_set1_epi32(second),
        _mm256_set1_epi32(third),
        _mm256_add_epi32(_mm256_set1_epi32(counter.number.cast_signed()), dealt),
    ]
}

/// Sets the first block of the first group to zero if its counter is 0.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn without_first(group: &mut Group) {
    let first = _mm256_setr_epi32(-1, 0, 0, 0, 0, 0, 0, 0);
    for word in &mut group[..3] {
        *word = _mm256_andnot_si256(first, *word);
    }
}

/// XORs the blocks of a group into `text`, big endian and in order.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn add_group(group: &Group, text: &mut [u8; GROUP]) {
    let swap = _mm_setr_epi8(3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12);
    // The last word of the state is the first of the block.
    let (first, second) = (_mm256_unpacklo_epi32(group[3], group[2]), _mm256_unpacklo_epi32(group[1], group[0]));
    let (third, fourth) = (_mm256_unpackhi_epi32(group[3], group[2]), _mm256_unpackhi_epi32(group[1], group[0]));
    let blocks = [
        _mm256_unpacklo_epi64(first, second),
        _mm256_unpackhi_epi64(first, second),
        _mm256_unpacklo_epi64(third, fourth),
        _mm256_unpackhi_epi64(third, fourth),
    ];
    for (pair, part) in blocks.into_iter().zip(text.as_chunks_mut::<32>().0) {
        add(shuffled(pair, swap), part);
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn add(vector: __m256i, part: &mut [u8; 32]) {
    let place = part.as_mut_ptr();
    // SAFETY: `part` is 32 bytes, borrowed alone; both accesses are unaligned ones.
    unsafe {
        let text = _mm256_loadu_si256(place.cast_const().cast());
        _mm256_storeu_si256(place.cast(), _mm256_xor_si256(text, vector));
    }
}

/// Defines `expand`, `apply` and `first` of a kernel by the functions of its file (`substituted` is its S-box), the
/// blocks of a group, and three instructions of its vectors.
macro_rules! sm4_vectors {
    ($features:literal, $blocks:literal, $zero:ident, $broadcast:ident, $lowest:ident) => {
        #[inline]
        #[target_feature(enable = $features)]
        fn rounds<const N: usize>(keys: &[u32; 32], groups: &mut [Group; N]) {
            for keys in keys.as_chunks::<4>().0 {
                for (at, key) in keys.iter().enumerate() {
                    let key = $broadcast(key.cast_signed());
                    for group in groups.iter_mut() {
                        let others = [group[(at + 1) % 4], group[(at + 2) % 4], group[(at + 3) % 4]];
                        group[at] = diffused(group[at], substituted(mixed(others, key)));
                    }
                }
            }
        }

        /// XORs the stream into `text`, `N` groups (`BYTES`) at a time, and returns the rest.
        #[inline]
        #[target_feature(enable = $features)]
        fn sweep<'a, const N: usize, const BYTES: usize>(
            keys: &[u32; 32],
            counter: &mut Counter,
            text: &'a mut [u8],
        ) -> &'a mut [u8] {
            let (batches, rest) = text.as_chunks_mut::<BYTES>();
            for batch in batches {
                let mut groups = [[$zero(); 4]; N];
                for group in &mut groups {
                    *group = counters(*counter);
                    counter.number = counter.number.wrapping_add($blocks);
                }
                rounds(keys, &mut groups);
                for (group, part) in groups.iter().zip(batch.as_chunks_mut::<GROUP>().0) {
                    add_group(group, part);
                }
            }
            rest
        }

        #[target_feature(enable = $features)]
        pub(super) fn apply(keys: &[u32; 32], mut counter: Counter, text: &mut [u8]) {
            let rest = sweep::<4, { 4 * GROUP }>(keys, &mut counter, text);
            let rest = sweep::<2, { 2 * GROUP }>(keys, &mut counter, rest);
            let rest = sweep::<1, GROUP>(keys, &mut counter, rest);
            if !rest.is_empty() {
                let mut last = Zeroizing::new([0; GROUP]);
                last[..rest.len()].copy_from_slice(rest);
                sweep::<1, GROUP>(keys, &mut counter, &mut *last);
                rest.copy_from_slice(&last[..rest.len()]);
            }
        }

        /// The first 16 blocks of a nonce: E(0), E(J0), then the stream.
        #[target_feature(enable = $features)]
        pub(super) fn first(keys: &[u32; 32], nonce: [u32; 3]) -> [u8; FIRST] {
            let mut groups = [[$zero(); 4]; FIRST / GROUP];
            for (group, number) in groups.iter_mut().zip((0u32..).step_by($blocks)) {
                *group = counters(Counter { nonce, number });
            }
            without_first(&mut groups[0]);
            rounds(keys, &mut groups);
            let mut out = [0; FIRST];
            for (group, part) in groups.iter().zip(out.as_chunks_mut::<GROUP>().0) {
                add_group(group, part);
            }
            out
        }

        #[target_feature(enable = $features)]
        pub(super) fn expand(key: &[u8; 16]) -> [u32; 32] {
            round_keys(key, |word| $lowest(substituted($broadcast(word.cast_signed()))).cast_unsigned())
        }
    };
}
pub(super) use sm4_vectors;
