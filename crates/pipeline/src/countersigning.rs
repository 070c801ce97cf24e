//! Both sides of a countersignature: what an owner states about its chain and recorder, and what a witness checks before
//! it signs that. Two statements of one party that cannot both be true are kept, with both signatures.

use std::sync::{Mutex, PoisonError};

use authros_evidence::time::{MOST_ROOTS, StampTree};
use authros_evidence::witness::{check_position, check_witness, countersign, network_of, state};
use tokio::task::block_in_place;

use crate::crypto::{SmKeyPair, signer_id};
use crate::model::{
    Address, Contradiction, Countersignature, Digest, Hash, Heads, Position, PublicKey, RecordState, SignedPosition,
    SignerId, Timestamp,
};
use crate::store::{AuditEntry, AuditLog, KeptContradiction, RecordQuery, Unwitnessed, WitnessRow};

use super::recorder_heads::TOPIC;
use super::{Network, Owner, PipelineError, Plant};

/// The most of a recorder's heads that are searched for a confirmed one.
const MOST_HEADS: usize = 16;
/// The most chains of which statements of one party are kept.
const MOST_CHAINS: u64 = 64;
/// Held while a statement is compared with those before it, until it is one of them.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// A statement to be countersigned, and the batches that it is about.
#[derive(Debug, Clone)]
pub struct Stated {
    /// The batches.
    pub batches: Unwitnessed,
    /// What is stated about them, signed.
    pub signed: SignedPosition,
}

/// What an owner has to state to a witness now: the batches that it has not countersigned, the chain's newest block that
/// anchors one of them, and the recorder's head. It refers to `last`, what this witness countersigned last, by the hash
/// that the chain has there now. `None` if there is nothing new.
///
/// # Errors
/// Errors of chain and ledger.
pub async fn stated(
    plant: &Plant,
    network: &Network,
    owner: &Owner,
    witness: SignerId,
    last: Option<&Countersignature>,
) -> Result<Option<Stated>, PipelineError> {
    let (of, chain, domain) = (owner.address, &network.chain, network.domain);
    let Some(pin) = chain.pin() else { return Ok(None) };
    let confirmed = (chain.head().await?.number + 1).saturating_sub(network.confirmations);
    let found = block_in_place(|| plant.ledger.unwitnessed((of, witness), domain, confirmed, MOST_ROOTS))?;
    let Some(batches) = found.filter(|batches| batches.block > 0) else { return Ok(None) };
    let Some(tree) = StampTree::new(batches.roots.clone()) else { return Ok(None) };
    let Some(block) = chain.block(batches.block).await? else { return Ok(None) };
    let earlier = match last {
        Some(last) => {
            let number = last.stated.position.block;
            let now = chain.block(number).await?.map_or(Hash([0; Hash::LENGTH]), |block| block.hash);
            Some((number, now))
        }
        None => None,
    };
    let position = Position {
        chain_id: pin.chain_id,
        genesis: pin.genesis,
        contract: pin.contract,
        owner: of,
        key: PublicKey([0; PublicKey::LENGTH]),
        recorder: plant.ledger.recorder(),
        block: block.number,
        block_hash: block.hash,
        earlier,
        top: tree.top(),
        count: tree.count(),
        head: block_in_place(|| head(plant, of))?,
    };
    let signed = state(position, &owner.gateway_identity(), plant.provider)?;
    Ok(Some(Stated { batches, signed }))
}

/// The newest confirmed head of this ledger's recorder, and its number.
fn head(plant: &Plant, owner: Address) -> Result<Option<(u64, Digest)>, PipelineError> {
    let query = RecordQuery {
        owner: Some(owner),
        recorder: Some(plant.ledger.recorder()),
        topic: Some(TOPIC.to_owned()),
        type_name: Some(Heads::TYPE.to_owned()),
        limit: MOST_HEADS,
        newest_first: true,
        ..RecordQuery::default()
    };
    let rows = plant.ledger.list(&query)?.rows;
    let confirmed = |state: RecordState| matches!(state, RecordState::Confirmed | RecordState::Verified);
    Ok(rows.into_iter().find(|row| confirmed(row.state)).map(|row| (row.seq, row.digest)))
}

/// What a witness answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answered {
    /// It countersigned the statement, and that is stored.
    Countersigned(Timestamp),
    /// It names what it countersigned last; the next statement has to refer to that.
    Last(Box<Countersignature>),
}

/// Takes a witness's answer: checked, and stored if it is over the statement.
///
/// # Errors
/// [`PipelineError::Refused`] if it is not by this witness, or is about something else; errors of the ledger.
pub fn answered(
    plant: &Plant,
    witness: &WitnessRow,
    stated: Stated,
    answer: Countersignature,
) -> Result<Answered, PipelineError> {
    let refused = |why: String| PipelineError::Refused(format!("the answer of the witness '{}': {why}", witness.name));
    check_witness(&answer, (witness.account, witness.key), plant.provider)
        .map_err(|error| refused(error.to_string()))?;
    let (asked, found) = (&stated.signed.position, &answer.stated.position);
    if answer.stated != stated.signed {
        if (found.owner, found.key, network_of(found)) != (asked.owner, asked.key, network_of(asked)) {
            return Err(refused("it is over a statement that was never made here".to_owned()));
        }
        return Ok(Answered::Last(Box::new(answer)));
    }
    let network = network_of(asked);
    plant.ledger.keep_position((witness.owner, witness.key), network, stated.batches, answer)?;
    Ok(Answered::Countersigned(answer.at))
}

/// Why a statement is not countersigned.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unsigned {
    /// Nobody here is a witness for that key.
    #[error("nobody here is a witness for the key {0}")]
    Stranger(SignerId),
    /// The key is known with another account.
    #[error("the key {key} is known with another account than {found}")]
    OtherAccount {
        /// The key.
        key: SignerId,
        /// The account that was stated.
        found: Address,
    },
    /// The statement is forged.
    #[error("{0}")]
    Forged(String),
    /// It contradicts one that was countersigned before.
    #[error("{0}")]
    Contradicts(Contradiction),
    /// It has stated as many chains as are kept of one party.
    #[error("the key {0} has stated {most} chains; the witness's operator can remove and add it to begin anew", most = MOST_CHAINS)]
    TooManyChains(SignerId),
    /// The ledger, or the key, fails.
    #[error("{0}")]
    Failed(String),
}

/// Countersigns what a party states, by the keeper's key; the answer to a statement that does not refer to the last one
/// is that one. What is given is stored before; a contradiction is stored and reported.
///
/// # Errors
/// [`Unsigned`].
pub fn countersigned(
    plant: &Plant,
    (account, key): (Address, &SmKeyPair),
    stated: &SignedPosition,
) -> Result<Countersignature, Unsigned> {
    let failed = |error: &dyn std::fmt::Display| Unsigned::Failed(error.to_string());
    let (position, party) = (&stated.position, signer_id(&stated.position.key));
    let rows = plant.ledger.witnesses().map_err(|error| failed(&error))?;
    let mut served = rows.iter().filter(|row| row.key == party && row.serves).peekable();
    let Some(first) = served.peek() else { return Err(Unsigned::Stranger(party)) };
    let name = first.name.clone();
    if !served.any(|row| row.account == position.owner) {
        return Err(Unsigned::OtherAccount { key: party, found: position.owner });
    }
    check_position(stated, plant.provider).map_err(|error| Unsigned::Forged(error.to_string()))?;
    // Two at a time could both refer to the same last one, and contradict each other.
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let network = network_of(position);
    let known = plant.ledger.countersigned_of(party, network).map_err(|error| failed(&error))?;
    // Also an older one: anybody who has a bundle can bring it again, and it says nothing against its owner.
    if let Some(given) = known.iter().find(|kept| kept.stated == *stated) {
        return Ok(*given);
    }
    let contradicted = |kept: &Countersignature| Some((*kept, position.contradicts(&kept.stated.position)?));
    if let Some((kept, contradiction)) = known.iter().find_map(contradicted) {
        tell(plant, (&name, party), (kept, *stated), contradiction).map_err(|error| failed(&error))?;
        return Err(Unsigned::Contradicts(contradiction));
    }
    match known.first() {
        Some(last) if position.earlier.is_none_or(|(block, _)| block != last.stated.position.block) => {
            return Ok(*last);
        }
        Some(_) => {}
        None => check_chain(plant, (&name, party), position)?,
    }
    let answer = countersign(*stated, Timestamp::now(), (account, key), plant.provider);
    let answer = answer.map_err(|error| failed(&error))?;
    plant.ledger.keep_countersigned(party, network, answer).map_err(|error| failed(&error))?;
    Ok(answer)
}

/// A party may move to another chain; whoever relies on the one before has to know. There is an end to it.
fn check_chain(plant: &Plant, (name, party): (&str, SignerId), position: &Position) -> Result<(), Unsigned> {
    let counted = plant.ledger.countersigned_count(party);
    let (_, chains) = counted.map_err(|error| Unsigned::Failed(error.to_string()))?;
    if chains >= MOST_CHAINS {
        return Err(Unsigned::TooManyChains(party));
    }
    if chains > 0 {
        plant.observer.alert(
            true,
            format!(
                "{name} ({}) states another chain than before, of id {}: nothing of the earlier one is contradicted, ask it \
                 why it moved",
                position.owner, position.chain_id
            ),
        );
    }
    Ok(())
}

/// Stores and reports two statements of one party that cannot both be true.
fn tell(
    plant: &Plant,
    (name, party): (&str, SignerId),
    (kept, later): (Countersignature, SignedPosition),
    contradiction: Contradiction,
) -> Result<(), PipelineError> {
    let (at, what) = (Timestamp::now(), contradiction.to_string());
    let found = KeptContradiction { party, at, what: what.clone(), kept, later };
    if !plant.ledger.keep_contradiction(found)? {
        return Ok(());
    }
    let owner = later.position.owner;
    AuditLog::new(plant.ledger.clone()).append(AuditEntry {
        at,
        profile: owner.to_string(),
        action: "equivocation".to_owned(),
        subject: format!("statements to a witness, of chain {}: {what}", later.position.chain_id),
        outcome: format!(
            "{} signed and was countersigned at {}; {} signed now",
            kept.stated.signature, kept.at, later.signature
        ),
    })?;
    plant.observer.alert(
        true,
        format!(
            "equivocation: {name} ({owner}) stated two histories of its chain: {what}; both statements are kept, `authros \
             witness status` shows them. Its chain was written anew, its home was restored, or it lies"
        ),
    );
    Ok(())
}

#[cfg(test)]
mod tests;
