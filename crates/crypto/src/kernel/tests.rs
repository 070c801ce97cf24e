//! Every kernel compared with the crates sm4, ctr and ghash, and the lanes of SM3 with the crate sm3.

use ::ghash::GHash;
use ::ghash::universal_hash::UniversalHash as _;
use ctr::cipher::{
    BlockCipherEncrypt as _, InnerIvInit as _, KeyInit as _, StreamCipher as _, StreamCipherCoreWrapper,
};
use ctr::{CtrCore, flavors::Ctr32BE};

use super::*;
use crate::gcm::{self, BlockCipher};
use crate::sm3::sm3;
use crate::{Result, sm4_gcm};

fn kernels() -> Vec<Available> {
    Kernel::ALL.into_iter().filter_map(Kernel::available).collect()
}

/// A random generator for tests (xorshift64*), so that a failure can be reproduced.
pub(crate) struct Noise(pub u64);

impl Noise {
    pub fn number(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    pub fn below(&mut self, bound: usize) -> usize {
        usize::try_from(self.number() >> 33).expect("31 bits") % bound
    }

    pub fn bytes(&mut self, length: usize) -> Vec<u8> {
        (0..length).map(|_| self.number().to_be_bytes()[0]).collect()
    }

    pub fn array<const N: usize>(&mut self) -> [u8; N] {
        std::array::from_fn(|_| self.number().to_be_bytes()[0])
    }
}

/// One SM4 key of the crate sm4, which looks its S-box up in a table; counter mode by the crate ctr.
pub(crate) struct Sm4Block(sm4::Sm4);

impl Sm4Block {
    pub fn new(key: &[u8; 16]) -> Self {
        Self(sm4::Sm4::new(&(*key).into()))
    }
}

impl BlockCipher for Sm4Block {
    fn encrypt_block(&self, block: &[u8; 16]) -> Result<[u8; 16]> {
        let mut block = (*block).into();
        self.0.encrypt_block(&mut block);
        Ok(block.into())
    }

    fn apply_counter(&self, counter: [u8; 16], data: &mut [u8]) -> Result<()> {
        let core = CtrCore::<_, Ctr32BE>::inner_iv_init(self.0.clone(), &counter.into());
        StreamCipherCoreWrapper::from_core(core).apply_keystream(data);
        Ok(())
    }
}

fn crate_apply(key: &[u8; 16], nonce: &[u8; 12], number: u32, text: &mut [u8]) {
    let mut counter = [0; 16];
    counter[..12].copy_from_slice(nonce);
    counter[12..].copy_from_slice(&number.to_be_bytes());
    let core = CtrCore::<_, Ctr32BE>::inner_iv_init(sm4::Sm4::new(&(*key).into()), &counter.into());
    StreamCipherCoreWrapper::from_core(core).apply_keystream(text);
}

#[test]
fn kernels_are_named_and_one_is_decided_upon() {
    assert!(Kernel::Portable.available().is_some());
    for kernel in Kernel::ALL {
        assert_eq!(kernel.to_string().parse(), Ok(kernel));
    }
    assert!(matches!("avx1024".parse::<Kernel>(), Err(KernelError::Unknown(_))));
    let decided = Available::decided();
    assert_eq!(decided.kernel().force(), Ok(()));
    for other in kernels().into_iter().filter(|other| *other != decided) {
        assert_eq!(other.kernel().force(), Err(KernelError::Decided(decided.kernel())));
    }
}

#[test]
fn every_length_is_encrypted_as_by_the_crates_at_every_offset() {
    let mut noise = Noise(1);
    let (key, nonce) = (noise.array(), noise.array());
    let plain = noise.bytes(4096);
    let mut stream = vec![0; 4096];
    crate_apply(&key, &nonce, 7, &mut stream);
    for kernel in kernels() {
        let cipher = Sm4::new(kernel, &key);
        for length in 0..=4096 {
            let offset = length % 67;
            let mut room = vec![0xee; offset + length + 3];
            room[offset..offset + length].copy_from_slice(&plain[..length]);
            cipher.apply(&nonce, 7, &mut room[offset..offset + length]);
            let expected = plain[..length].iter().zip(&stream).map(|(byte, mask)| byte ^ mask);
            assert!(room[offset..offset + length].iter().copied().eq(expected), "{kernel:?} {length}");
            let outside = room[..offset].iter().chain(&room[offset + length..]);
            assert!(outside.copied().all(|byte| byte == 0xee), "{kernel:?} {length}");
        }
    }
}

#[test]
fn the_counter_wraps_at_32_bits_and_the_nonce_stays() {
    let mut noise = Noise(2);
    for kernel in kernels() {
        for before in [1u32, 2, 15, 16, 17, 31, 47, 63, 64, 100] {
            let (key, nonce) = (noise.array(), [0xff; 12]);
            let number = 0u32.wrapping_sub(before);
            let mut one = noise.bytes(3000);
            let mut other = one.clone();
            Sm4::new(kernel, &key).apply(&nonce, number, &mut one);
            crate_apply(&key, &nonce, number, &mut other);
            assert_eq!(one, other, "{kernel:?} {before}");
        }
    }
}

#[test]
fn the_first_batch_is_zero_then_the_counters_from_one() {
    let mut noise = Noise(3);
    for kernel in kernels() {
        let (key, nonce) = (noise.array(), noise.array());
        let first = Sm4::new(kernel, &key).first(&nonce);
        let mut expected = [0; FIRST];
        crate_apply(&key, &[0; 12], 0, &mut expected[..16]);
        crate_apply(&key, &nonce, 1, &mut expected[16..]);
        assert_eq!(*first, expected, "{kernel:?}");
    }
}

#[test]
fn every_length_is_hashed_as_by_the_crate() {
    let mut noise = Noise(4);
    for kernel in kernels() {
        for length in (0..=600).chain([1023, 1024, 4095, 4096, 5000]) {
            let (key, text, more) = (noise.array(), noise.bytes(length), noise.bytes(40));
            let mut one = Ghash::new(kernel, &key, length.max(40));
            let mut other = GHash::new(&key.into());
            for part in [&more, &text, &more] {
                one.update(part);
                other.update_padded(part);
            }
            let expected: [u8; 16] = other.finalize().into();
            assert_eq!(one.finish(), expected, "{kernel:?} {length}");
        }
    }
}

/// Seals random texts with each kernel and with the crates; AAD, text and offset have random lengths.
#[test]
fn random_records_are_sealed_alike_and_opened() {
    let long = std::env::var_os("AUTHROS_LONG").is_some();
    let cases = if long { 1_000_000 } else { 4_000 };
    let mut noise = Noise(5);
    let kernels = kernels();
    for case in 0..cases {
        let (key, nonce): ([u8; 16], [u8; 12]) = (noise.array(), noise.array());
        let (aad, length) = (noise.below(120), noise.below(if case % 64 == 0 { 9000 } else { 400 }));
        let (aad, plain) = (noise.bytes(aad), noise.bytes(length));
        let mut expected = plain.clone();
        let tag = gcm::seal(&Sm4Block::new(&key), &nonce, &aad, &mut expected).expect("seals");
        expected.extend_from_slice(&tag);
        let kernel = kernels[case % kernels.len()];
        let offset = noise.below(32);
        let mut room = vec![0; offset + length];
        room[offset..].copy_from_slice(&plain);
        let tag = sm4_gcm::seal(kernel, &key, &nonce, &aad, &mut room[offset..]).expect("seals");
        room.extend_from_slice(&tag);
        assert_eq!(room[offset..], expected, "{kernel:?} case {case}");
        let opened = sm4_gcm::open(kernel, &key, &nonce, &aad, &room[offset..]).expect("opens");
        assert_eq!(*opened, plain, "{kernel:?} case {case}");
        let at = noise.below(expected.len());
        expected[at] ^= 1 << noise.below(8);
        assert!(sm4_gcm::open(kernel, &key, &nonce, &aad, &expected).is_err(), "{kernel:?} case {case}");
    }
}

#[test]
fn many_messages_have_the_hashes_they_have_alone() {
    let mut noise = Noise(6);
    for count in (0..40).chain([100, 333]) {
        let messages: Vec<Vec<u8>> = (0..count)
            .map(|at| {
                let length = if at % 50 == 49 { 20_000 } else { noise.below(300) };
                noise.bytes(length)
            })
            .collect();
        let messages: Vec<&[u8]> = messages.iter().map(Vec::as_slice).collect();
        let alone: Vec<[u8; 32]> = messages.iter().map(|message| sm3(&[message])).collect();
        assert_eq!(digest_many(&messages), alone, "{count} messages");
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the feature was just detected.
            let eight = sm3_lanes::in_lanes::<8>(&messages, |states, blocks| unsafe {
                sm3_avx2::compress(states, blocks);
            });
            assert_eq!(eight, alone, "{count} messages in eight lanes");
        }
    }
}

#[test]
fn every_length_has_its_padding() {
    let mut noise = Noise(7);
    let text = noise.bytes(260);
    let messages: Vec<&[u8]> = (0..=260).map(|length| &text[..length]).collect();
    let alone: Vec<[u8; 32]> = messages.iter().map(|message| sm3(&[message])).collect();
    assert_eq!(digest_many(&messages), alone);
}

/// The compression of blocks alone, in each variant.
#[cfg(target_arch = "x86_64")]
type Way = fn(&mut [u32; 8], &[[u8; BLOCK]]);

#[cfg(target_arch = "x86_64")]
fn ways() -> Vec<(&'static str, Way)> {
    let mut ways: Vec<(&'static str, Way)> = vec![("chosen", compress)];
    let turns = is_x86_feature_detected!("bmi1") && is_x86_feature_detected!("bmi2");
    if turns && is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw") {
        ways.push(("avx512", |state, blocks| {
            let (groups, rest) = blocks.as_chunks();
            // SAFETY: the features were just detected.
            unsafe { sm3_avx512::compress_one(state, groups) };
            sm3::by_crate(state, rest);
        }));
    }
    if turns && is_x86_feature_detected!("avx2") {
        ways.push(("avx2", |state, blocks| {
            let (groups, rest) = blocks.as_chunks();
            // SAFETY: the features were just detected.
            unsafe { sm3_avx2::compress_one(state, groups) };
            sm3::by_crate(state, rest);
        }));
    }
    ways
}

#[test]
#[cfg(target_arch = "x86_64")]
fn blocks_of_one_message_are_compressed_as_by_the_crate() {
    let mut noise = Noise(8);
    for count in (0..=100).chain([255, 256, 1000]) {
        let before: [u32; 8] = std::array::from_fn(|_| u32::from_be_bytes(noise.array()));
        let offset = noise.below(64);
        let room = noise.bytes(offset + count * BLOCK);
        let blocks = room[offset..].as_chunks().0;
        let mut expected = before;
        sm3::by_crate(&mut expected, blocks);
        for (name, way) in ways() {
            let mut state = before;
            way(&mut state, blocks);
            assert_eq!(state, expected, "{count} blocks by {name}");
        }
    }
}
