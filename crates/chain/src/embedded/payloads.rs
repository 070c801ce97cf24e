//! Programs that run long for their gas, for the tests of admission: each fills memory, then loops until its gas is
//! used up.

use alloy_primitives::{U256, keccak256};

use crate::model::{Address, Hash};
use crate::transaction::{Transaction, Unsigned};

/// Creation code: a part that runs once, then a part that repeats.
pub struct Payload {
    pub name: String,
    /// Its bytes.
    pub code: Vec<u8>,
}

/// PUSH with no more bytes than the value needs.
fn push(value: u64) -> Vec<u8> {
    let bytes = value.to_be_bytes();
    let from = bytes.iter().position(|byte| *byte != 0).unwrap_or(7);
    let mut code = vec![0x5f + u8::try_from(8 - from).expect("at most 8")];
    code.extend(&bytes[from..]);
    code
}

fn push_word(word: [u8; 32]) -> Vec<u8> {
    [&[0x7f][..], &word].concat()
}

fn mstore(at: u64, word: [u8; 32]) -> Vec<u8> {
    [push_word(word), push(at), vec![0x52]].concat()
}

fn number(value: u64) -> [u8; 32] {
    let mut word = [0; 32];
    word[24..].copy_from_slice(&value.to_be_bytes());
    word
}

impl Payload {
    fn new(name: impl Into<String>, once: Vec<u8>, repeated: &[u8]) -> Self {
        let at = once.len() as u64;
        // JUMPDEST, the body several times, PUSH4 back, JUMP.
        let body = repeated.repeat((600 / repeated.len().max(1)).max(1));
        let back = [&[0x63][..], &u32::try_from(at).expect("short").to_be_bytes(), &[0x56]].concat();
        Self { name: name.into(), code: [once, vec![0x5b], body, back].concat() }
    }

    /// Calls a precompiled contract with `input` bytes of memory, each time with all gas but a 64th.
    fn precompiled(name: impl Into<String>, contract: u64, once: Vec<u8>, input: u64) -> Self {
        // STATICCALL(gas, contract, 0, input, 0, 64)
        let call = [push(64), push(0), push(input), push(0), push(contract), vec![0x5a, 0xfa, 0x50]].concat();
        Self::new(name, once, &call)
    }

    /// MODEXP of this many bytes of `fill` each.
    pub fn modexp(base: u64, exponent: u64, modulus: u64, fill: u8) -> Self {
        let lengths = [base, exponent, modulus].into_iter().zip([0u64, 32, 64]);
        let mut once: Vec<u8> = lengths.flat_map(|(length, at)| mstore(at, number(length))).collect();
        let total = base + exponent + modulus;
        // The first words one by one; beyond them the memory is copied onto itself, doubling (contract 4).
        let mut filled = 96;
        while filled < (96 + total).min(96 + 512) {
            once.extend(mstore(filled, [fill; 32]));
            filled += 32;
        }
        while filled < 96 + total {
            let length = (filled - 96).min(96 + total - filled);
            once.extend([push(length), push(filled), push(length), push(96), push(4), vec![0x5a, 0xfa, 0x50]].concat());
            filled += length;
        }
        Self::precompiled(format!("MODEXP {base} {exponent} {modulus} of {fill:#x}"), 5, once, 96 + total)
    }

    /// One call of BLAKE2F with this many rounds.
    pub fn blake2f(rounds: u32) -> Self {
        let mut word = [0; 32];
        word[..4].copy_from_slice(&rounds.to_be_bytes());
        Self::precompiled(format!("BLAKE2F of {rounds} rounds"), 9, mstore(0, word), 213)
    }

    pub fn sstore() -> Self {
        Self::new("SSTORE of new slots", push(1), &[0x80, 0x80, 0x55, 0x60, 1, 0x01])
    }

    /// MODEXP with a long exponent and a short base, the cheapest for its time.
    pub fn long_exponent() -> Self {
        Self::modexp(1, 40_000, 1, 0xff)
    }

    pub fn all() -> Vec<Self> {
        let hashes = |length: u64| [push(length), push(0), vec![0x20, 0x50]].concat();
        let mut signature = mstore(0, [7; 32]);
        signature.extend(mstore(32, number(27)));
        signature.extend(mstore(64, [9; 32]));
        signature.extend(mstore(96, [5; 32]));
        let point = [mstore(0, number(1)), mstore(32, number(2)), mstore(64, [0x1f; 32])].concat();
        let points =
            [mstore(0, number(1)), mstore(32, number(2)), mstore(64, number(1)), mstore(96, number(2))].concat();
        let unknown = |code: u8| [vec![0x5a, 0x5a, 0x02, 0x5a, 0x02], vec![code, 0x50]].concat();
        let mut all = vec![
            Self::blake2f(9_000_000),
            Self::blake2f(1),
            Self::sstore(),
            Self::precompiled("ecrecover", 1, signature, 128),
            Self::precompiled("SHA-256 of 64 KiB", 2, mstore(65_536 - 32, [1; 32]), 65_536),
            Self::precompiled("SHA-256 of 1 byte", 2, Vec::new(), 1),
            Self::precompiled("RIPEMD-160 of 64 KiB", 3, mstore(65_536 - 32, [1; 32]), 65_536),
            Self::precompiled("identity of 64 KiB", 4, mstore(65_536 - 32, [1; 32]), 65_536),
            Self::precompiled("alt_bn128 addition", 6, points, 128),
            Self::precompiled("alt_bn128 multiplication", 7, point, 96),
            Self::precompiled("alt_bn128 pairing of zeros", 8, Vec::new(), 192 * 8),
            Self::new("KECCAK of 32 bytes", push(0), &hashes(32)),
            Self::new("KECCAK of 64 KiB", push(0), &hashes(65_536)),
            Self::new("SLOAD of unknown slots", push(0), &[0x5a, 0x54, 0x50]),
            Self::new("EXTCODEHASH of unknown accounts", push(0), &unknown(0x3f)),
            Self::new("EXTCODESIZE of unknown accounts", push(0), &unknown(0x3b)),
            Self::new("BALANCE of unknown accounts", push(0), &unknown(0x31)),
            Self::new("EXP", push(0), &[push_word([0xff; 32]), push_word([0xfd; 32]), vec![0x0a, 0x50]].concat()),
            Self::new("MULMOD", push_word([0xee; 32]), &[0x80, 0x80, 0x80, 0x09, 0x50]),
            Self::new("SDIV", push_word([0xee; 32]), &[0x80, 0x80, 0x05, 0x50]),
            Self::new("JUMPDEST", Vec::new(), &[0x5b]),
            Self::new("LOG4 of 1 KiB", push(0), &[vec![0x80; 4], push(1024), push(0), vec![0xa4]].concat()),
            // CREATE2(0, 0, 0, salt) of nothing.
            Self::new(
                "CREATE2 of nothing",
                push(0),
                &[vec![0x5a], push(0), push(0), push(0), vec![0xf5, 0x50]].concat(),
            ),
            Self::new(
                "CREATE2 of 48 KiB of STOP",
                push(0),
                &[vec![0x5a], push(49_152), push(0), push(0), vec![0xf5, 0x50]].concat(),
            ),
            Self::new("CALLDATACOPY of 64 KiB", Vec::new(), &[push(65_536), push(0), push(0), vec![0x37]].concat()),
        ];
        for (base, exponent, modulus) in [
            (1, 32, 1),
            (1, 1_000, 1),
            (1, 40_000, 1),
            (8, 32, 8),
            (8, 2_000, 8),
            (32, 32, 32),
            (32, 500, 32),
            (64, 64, 64),
            (128, 128, 128),
            (256, 32, 256),
            (1_024, 1, 1_024),
            (1, 4_000, 64),
            (1_024, 64, 8),
        ] {
            for fill in [0xff, 0xfe] {
                all.push(Self::modexp(base, exponent, modulus, fill));
            }
        }
        all
    }

    /// A transaction that creates a contract with it. It is not signed.
    pub fn transaction(&self, sender: Address, nonce: u64, gas_limit: u64) -> Transaction {
        let hash = Hash(keccak256([&sender.0[..], &nonce.to_be_bytes()].concat()).0);
        let unsigned = Unsigned { nonce, gas_limit, input: self.code.clone(), ..Unsigned::default() };
        Transaction { hash, sender, unsigned, v: 0, r: U256::ZERO, s: U256::ZERO, raw: self.code.clone() }
    }
}
