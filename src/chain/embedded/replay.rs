//! Opening a chain again: every block of the file is checked, run anew and compared.

use ethers::types::Bloom;
use ethers::utils::rlp;

use super::block::{Header, receipts_root, transactions_root};
use super::file::{ChainFile, Mined};
use super::machine::{Environment, Machine, Outcome};
use super::sealing::Sealing;
use super::transaction::Transaction;
use crate::chain::ChainError;
use crate::model::Hash;

/// Runs all blocks above `genesis`; gives the newest header.
///
/// # Errors
/// [`ChainError::Tampered`] for the first block that does not come out as it is in the file, or whose
/// seal is not what the chain's consensus wants.
pub fn replay(
    file: &ChainFile,
    machine: &mut Machine,
    sealing: &mut Sealing,
    chain_id: u64,
    genesis: Header,
) -> Result<Header, ChainError> {
    let mut last = genesis;
    file.replay(|number, hash, header, mined| {
        if number == 0 {
            return Ok(());
        }
        let blame = |what: &str| file.tampered(number, what);
        let header = Header::decode(&header).map_err(|_| blame("its header is not a header"))?;
        if header.hash() != hash || header.parent != last.hash() || header.number != number {
            return Err(blame("its hash or its parent is not what it was"));
        }
        let place = sealing.accept(&header, last.timestamp).map_err(blame)?;
        let outcome = rerun(machine, sealing, &header, &place, chain_id, &mined).map_err(|what| blame(&what))?;
        machine.apply(outcome);
        last = header;
        Ok(())
    })?;
    sealing.vouches(&last).map_err(|what| file.tampered(last.number, what))?;
    Ok(last)
}

/// Runs a block of the file again and compares all that its header commits to.
fn rerun(
    machine: &Machine,
    sealing: &Sealing,
    header: &Header,
    place: &Environment,
    chain_id: u64,
    mined: &[Mined],
) -> Result<Outcome, String> {
    let decode = |one: &Mined| Transaction::decode(&one.raw, chain_id, Some(one.sender));
    let transactions = mined.iter().map(decode).collect::<Result<Vec<_>, _>>()?;
    let outcome = machine.run(place, transactions);
    let again = assemble(sealing, header.parent, place, &outcome);
    let sealed = Header { extra: header.extra.clone(), nonce: header.nonce, ..again.clone() };
    // Under proof of work the extra data holds no seal, and is always the same.
    if sealed != *header || (matches!(sealing, Sealing::Work { .. }) && again.extra != header.extra) {
        return Err("running its transactions again gives another block".into());
    }
    let kept = outcome.receipts.iter().zip(mined).all(|(receipt, one)| rlp::encode(receipt)[..] == one.receipt[..]);
    if kept { Ok(outcome) } else { Err("its receipts are not what they were".into()) }
}

/// The header of a block that ran, before its seal.
pub fn assemble(sealing: &Sealing, parent: Hash, place: &Environment, outcome: &Outcome) -> Header {
    let mut bloom = Bloom::zero();
    for receipt in &outcome.receipts {
        receipt.accrue(&mut bloom);
    }
    let (beneficiary, extra) = sealing.dress();
    Header {
        parent,
        state_root: outcome.state_root,
        transactions_root: transactions_root(&outcome.included),
        receipts_root: receipts_root(&outcome.receipts),
        bloom,
        beneficiary,
        difficulty: place.difficulty,
        number: place.number,
        gas_used: outcome.receipts.last().map_or(0, |receipt| receipt.cumulative_gas),
        timestamp: place.timestamp,
        extra,
        nonce: 0,
    }
}
