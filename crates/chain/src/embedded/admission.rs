//! Rules of admission: what this node accepts into its pool and its blocks, so that no caller stalls the chain's single
//! thread. They are not rules of the chain: replaying a block from the file ignores them.
//!
//! Gas does not measure time where Istanbul's prices are wrong: MODEXP with a long exponent takes a hundred times as
//! long as its gas says, ecrecover three times. What such a call should cost above its price is counted as surplus.

use revm::context_interface::{Cfg, ContextTr};
use revm::handler::{EthPrecompiles, PrecompileProvider};
use revm::interpreter::{CallInputs, InterpreterResult};
use revm::precompile::modexp::{byzantium_gas_calc, osaka_gas_calc};
use revm::primitives::hardfork::SpecId;
use revm::primitives::{Address as EvmAddress, AddressSet, U256 as Word};

/// The most gas of one transaction, call or estimate.
pub const TRANSACTION_GAS: u64 = 10_000_000;
/// The most gas of all transactions of a block.
pub const BLOCK_GAS: u64 = 20_000_000;
/// The most gas that all runs of one estimate may use together.
pub const ESTIMATE_GAS: u64 = 40_000_000;
/// The most surplus of one transaction or call.
pub const TRANSACTION_SURPLUS: u64 = 10_000_000;
/// A block with this much surplus takes no further transaction.
pub const BLOCK_SURPLUS: u64 = 10_000_000;
/// Prefix of the refusal.
pub const TOO_MUCH_WORK: &str = "too much work for its gas";

/// The address of ecrecover.
const ECRECOVER: EvmAddress = revm::precompile::u64_to_address(1);
/// Its price.
const ECRECOVER_GAS: u64 = 3_000;
/// Its surplus, measured against the other instructions.
const ECRECOVER_SURPLUS: u64 = 6_000;
/// The address of MODEXP (EIP-198).
const MODEXP: EvmAddress = revm::precompile::u64_to_address(5);
/// Bytes of MODEXP's three lengths.
const LENGTHS: usize = 96;

/// Istanbul's precompiled contracts, and how much more work they did than their gas says.
#[derive(Debug)]
pub struct Weighed {
    precompiles: EthPrecompiles,
    /// The surplus so far, in gas.
    pub surplus: u64,
    most: u64,
}

impl Weighed {
    /// Allows a surplus of at most `most`.
    pub fn new(most: u64) -> Self {
        Self { precompiles: EthPrecompiles::new(SpecId::ISTANBUL), surplus: 0, most }
    }
}

impl<C: ContextTr> PrecompileProvider<C> for Weighed {
    type Output = InterpreterResult;

    fn set_spec(&mut self, spec: <C::Cfg as Cfg>::Spec) -> bool {
        <EthPrecompiles as PrecompileProvider<C>>::set_spec(&mut self.precompiles, spec)
    }

    fn run(&mut self, context: &mut C, inputs: &CallInputs) -> Result<Option<InterpreterResult>, String> {
        let more = match inputs.bytecode_address {
            MODEXP => surplus(&inputs.input.as_bytes(context), inputs.gas_limit),
            ECRECOVER if inputs.gas_limit >= ECRECOVER_GAS => ECRECOVER_SURPLUS,
            _ => 0,
        };
        self.surplus = self.surplus.saturating_add(more);
        if self.surplus > self.most {
            return Err(format!(
                "{TOO_MUCH_WORK}: its MODEXP or ecrecover calls cost far less gas than the time they take"
            ));
        }
        self.precompiles.run(context, inputs)
    }

    fn warm_addresses(&self) -> &AddressSet {
        self.precompiles.warm_addresses()
    }
}

/// How much more a call of MODEXP costs under EIP-7883 than under EIP-198; 0 if it cannot pay for itself.
fn surplus(input: &[u8], gas: u64) -> u64 {
    let mut head = [0; LENGTHS + 32];
    let word = |at: usize, head: &[u8]| Word::from_be_slice(&head[at..at + 32]);
    let known = input.len().min(LENGTHS);
    head[..known].copy_from_slice(&input[..known]);
    let [base, exponent, modulus] = [0, 32, 64].map(|at| word(at, &head).saturating_to::<u64>());
    let first = usize::try_from(base).ok().and_then(|base| input.get(LENGTHS.checked_add(base)?..)).unwrap_or_default();
    let (length, known) = (usize::try_from(exponent.min(32)).unwrap_or(32), first.len().min(32));
    // The highest 32 bytes of the exponent, as a number.
    let place = LENGTHS + 32 - length;
    head[LENGTHS..].fill(0);
    let known = known.min(length);
    head[place..place + known].copy_from_slice(&first[..known]);
    let highest = word(LENGTHS, &head);
    let price = byzantium_gas_calc(base, exponent, modulus, &highest);
    if price > gas { 0 } else { osaka_gas_calc(base, exponent, modulus, &highest).saturating_sub(price) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn call(lengths: [u64; 3], rest: &[u8]) -> Vec<u8> {
        let words = lengths.iter().flat_map(|length| Word::from(*length).to_be_bytes::<32>());
        words.chain(rest.iter().copied()).collect()
    }

    #[test]
    fn a_long_exponent_has_a_surplus_and_an_unpaid_one_none() {
        // EIP-198: 1 * (8 * (1000 - 32) + 7) / 20; EIP-7883: 16 * (16 * (1000 - 32) + 7).
        let long = call([1, 1000, 1], &[1, 0x80]);
        let exponent = 255;
        assert_eq!(surplus(&long, 1_000), 16 * (16 * 968 + exponent) - (8 * 968 + exponent) / 20);
        assert_eq!(surplus(&long, 100), 0);
        // An example of EIP-198: 3 ^ (2^256 - 2^32 - 978) mod (2^256 - 2^32 - 977) costs 13,056.
        let mut fermat = call([1, 32, 32], &[3]);
        fermat.extend([0xff; 27]);
        fermat.extend([0xfe, 0xff, 0xff, 0xfc, 0x2e]);
        assert_eq!(surplus(&fermat, 13_055), 0);
        assert_eq!(surplus(&fermat, 13_056), 0, "16 * 255 is less");
        for noise in [&[][..], &[0xff; 31], &[0xff; 200]] {
            assert_eq!(surplus(noise, 1_000_000), if noise.is_empty() { 500 } else { 0 }, "{}", noise.len());
        }
    }
}
