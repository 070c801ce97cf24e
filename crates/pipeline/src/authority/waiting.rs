//! Records that nobody here anchors, because their signer may not sign for its owner now. They wait, and continue by
//! themselves.

use super::signing::{Moment, NoRight, may_sign};
use crate::model::Address;
use crate::pipeline::{Network, PipelineError, Plant};
use crate::store::WaitingSigner;

/// Holds back what `keeper` would anchor although its signer may not sign now, and releases what waited for a right
/// that is back. To be called before anything is anchored.
///
/// # Errors
/// Errors of the ledger; the next call does what is left.
pub fn settle_waiting(plant: &Plant, network: &Network, keeper: Address) -> Result<(), PipelineError> {
    for waiting in plant.ledger.waiting_signers(keeper)? {
        let now = Moment::newest(network.directory.now());
        match may_sign(&network.directory, waiting.owner, waiting.signer, now) {
            Ok(_) if waiting.held => free(plant, keeper, waiting)?,
            // Before an owner is registered its records wait for that, like all others.
            Ok(_) | Err(NoRight::Unregistered { .. }) => {}
            Err(why) if waiting.ready => hold(plant, keeper, waiting, &why)?,
            Err(_) => {}
        }
    }
    Ok(())
}

fn hold(plant: &Plant, keeper: Address, waiting: WaitingSigner, why: &NoRight) -> Result<(), PipelineError> {
    let mut held = 0;
    loop {
        match plant.ledger.hold_signer(keeper, waiting.owner, waiting.signer)? {
            0 => break,
            more => held += more,
        }
    }
    // Messages captured meanwhile join the waiting ones; this is reported once.
    if held > 0 && !waiting.held {
        plant.observer.alert(true, format!("records are kept but not anchored: {why}"));
    }
    if held > 0 {
        plant.observer.records_changed();
    }
    Ok(())
}

fn free(plant: &Plant, keeper: Address, waiting: WaitingSigner) -> Result<(), PipelineError> {
    let mut freed = 0;
    loop {
        match plant.ledger.free_signer(keeper, waiting.owner, waiting.signer)? {
            0 => break,
            more => freed += more,
        }
    }
    if freed > 0 {
        let owner = waiting.owner;
        plant.observer.alert(false, format!("{freed} records of {owner} resume: their signer may sign again"));
        plant.observer.records_changed();
    }
    Ok(())
}
