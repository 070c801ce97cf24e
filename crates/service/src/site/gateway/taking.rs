//! Records that another gateway of the fleet hands over: each is checked as if its robot had sent it here, against the
//! chain that is known here, and goes the one way into vault and ledger. A gateway that lies gets nothing in.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use async_trait::async_trait;
use tokio::task::block_in_place;

use super::GatewayDesk;
use super::copies::Copies;
use super::fetching::{Claim, Which};
use super::round::{Handed, Here, Numbered, Round, Took};
use super::round_erased::TookErased;
use crate::chain::AnchorProof;
use crate::chain::merkle::Inclusion;
use crate::crypto::signer_id;
use crate::gateway::identity_check::verify_each;
use crate::gateway::{Code, Context, Desk as _, Fetched, Held, Received, Refusal, ToldErasure, Upload, Wanted};
use crate::model::{Address, Digest, Header, PublicKey, SignerId};
use crate::pipeline::authority::{Moment, SigningRight, may_sign};
use crate::pipeline::mirror::{Anchors, wait_for};
use crate::pipeline::{Network, PipelineError};
use crate::service::event::Part;
use crate::store::{Lacking, RootSighting};

/// How long the watcher here may lag behind the block of a proof.
const BEHIND: Duration = Duration::from_secs(3);

/// A record that holds.
#[derive(Clone)]
struct Proven {
    received: Received,
    /// Its anchor as the chain has it.
    anchor: (Digest, Inclusion, RootSighting),
    /// The device that signed it, with its key.
    device: Option<(SignerId, PublicKey)>,
}

/// What is found of a record.
enum Judged {
    /// It holds.
    Holds(Box<Proven>),
    /// The chain here does not have the block of its anchor yet.
    Later,
}

/// What was seen while others of the same records were judged.
#[derive(Default)]
struct Known {
    /// The highest block that the watcher was seen to have read.
    read: Option<u64>,
}

/// The side of a round that takes.
pub(super) struct Taking<'a> {
    /// Keeps records.
    pub desk: &'a GatewayDesk,
    /// Anchors that the chain confirmed.
    pub anchors: &'a Anchors,
    /// Which records are kept here.
    pub copies: Copies,
}

#[async_trait]
impl Here for Taking<'_> {
    fn welcomes(&self, owner: &Address) -> Result<(), Refusal> {
        block_in_place(|| self.desk.check_owner(owner))
    }

    fn copies(&self) -> Copies {
        self.copies.clone()
    }

    fn lacking(&self, held: &[Held]) -> Result<Vec<Lacking>, Refusal> {
        let ledger = &self.desk.gateway.plant.ledger;
        let lacking =
            |Held { owner, recorder, topic_id, ranges }: &Held| ledger.lacking((*owner, *recorder, *topic_id), ranges);
        let found: Result<Vec<_>, _> = block_in_place(|| held.iter().map(lacking).collect());
        found.map_err(Refusal::because(Code::Internal))
    }

    fn claim(&self, which: Which, wanted: Vec<u64>) -> Claim {
        self.desk.gateway.fetching.claim(which, wanted)
    }

    async fn take(&self, parts: Vec<Handed>) -> Result<Took, Refusal> {
        let network = self.desk.known_network()?;
        let (mut proven, mut later, mut refused) = (Vec::new(), BTreeSet::new(), Vec::new());
        let parts = self.of_accounts(parts, &mut refused).await?;
        let (mut known, mut silent) = (Known::default(), None);
        for (received, proof) in self.received(&network, parts, &mut refused).await? {
            let number = number_of(&received.header);
            if silent.is_some() {
                later.insert(number);
                continue;
            }
            match self.proven(&network, received, &proof, &mut known).await {
                Ok(Judged::Holds(one)) => proven.push(*one),
                Ok(Judged::Later) => {
                    later.insert(number);
                }
                // What was judged before is kept all the same.
                Err(refusal) if matches!(refusal.code, Code::Stale | Code::Internal) => {
                    later.insert(number);
                    silent = Some(refusal);
                }
                Err(refusal) => refused.push(refusal),
            }
        }
        let taken = block_in_place(|| self.keep(proven, &mut refused))?;
        Ok(Took { taken, later, refused, silent })
    }

    async fn erase(&self, told: Vec<ToldErasure>, patient: bool, round: &mut Round) -> Result<TookErased, Refusal> {
        self.erase_told(told, patient, round).await
    }
}

impl Taking<'_> {
    /// What is of accounts that are registered and not suspended, as of now.
    async fn of_accounts(&self, mut parts: Vec<Handed>, refused: &mut Vec<Refusal>) -> Result<Vec<Handed>, Refusal> {
        let owners: BTreeSet<Address> = parts.iter().map(|part| part.wanted.owner).collect();
        for owner in owners {
            match self.desk.account(&owner).await {
                Ok(_) => {}
                Err(refusal) if refusal.code == Code::Stale => return Err(refusal),
                Err(refusal) => {
                    parts.retain(|part| part.wanted.owner != owner);
                    refused.push(refusal);
                }
            }
        }
        Ok(parts)
    }

    /// Records that were asked for and are signed, with the bytes of their proofs; the others are refused.
    async fn received(
        &self,
        network: &Network,
        parts: Vec<Handed>,
        refused: &mut Vec<Refusal>,
    ) -> Result<Vec<(Received, Vec<u8>)>, Refusal> {
        let (mut uploads, mut signers, mut proofs) = (Vec::new(), Vec::new(), Vec::new());
        let records = parts
            .into_iter()
            .flat_map(|Handed { wanted, records, .. }| records.into_iter().map(move |one| (wanted, one)));
        for (wanted, record) in records {
            match asked_for(network, &wanted, &record) {
                Ok(()) => {
                    let Fetched { signer, signature, proof, blob } = record;
                    uploads.push(Upload { signature, blob });
                    signers.push(signer);
                    proofs.push(proof);
                }
                Err(refusal) => refused.push(refusal),
            }
        }
        let context = Context { provider: self.desk.gateway.plant.provider, domain: network.domain };
        let checked = tokio::task::spawn_blocking(move || verify_each(context, uploads, &signers)).await;
        let checked = checked.map_err(Refusal::because(Code::Internal))?;
        let mut received = Vec::with_capacity(checked.len());
        for (checked, proof) in checked.into_iter().zip(proofs) {
            match checked {
                Ok(record) => received.push((record, proof)),
                Err(refusal) => refused.push(refusal),
            }
        }
        Ok(received)
    }

    /// In place of a robot's session stands the anchor: the signer's right is judged by its block.
    async fn proven(
        &self,
        network: &Network,
        received: Received,
        proof: &[u8],
        known: &mut Known,
    ) -> Result<Judged, Refusal> {
        let proof = AnchorProof::parse(proof)?;
        let confirmed = self.anchors.confirm(network, &received.header, received.digest, proof).await;
        let proof = match confirmed {
            Err(PipelineError::NotSeen { .. }) => return Ok(Judged::Later),
            confirmed => confirmed.map_err(|error| failed(&error))?,
        };
        let device = self.signing_device(network, &received, proof.block, known).await?;
        let AnchorProof { account, transaction, block, block_hash, inclusion } = proof;
        let inclusion = inclusion.ok_or_else(|| Refusal::new(Code::Malformed, "a gateway's anchors are batches"))?;
        let anchor =
            RootSighting { account, root: inclusion.root, count: inclusion.count, transaction, block, block_hash };
        let digest = received.digest;
        Ok(Judged::Holds(Box::new(Proven { received, anchor: (digest, inclusion, anchor), device })))
    }

    /// The device that signed, if it was not the owner; whoever had no right is refused.
    async fn signing_device(
        &self,
        network: &Network,
        received: &Received,
        block: u64,
        known: &mut Known,
    ) -> Result<Option<(SignerId, PublicKey)>, Refusal> {
        let plant = &self.desk.gateway.plant;
        if known.read.is_none_or(|read| read < block) {
            wait_for(plant, block, BEHIND).await.map_err(|error| failed(&error))?;
            known.read = Some(block);
        }
        let time = network.ask_time(block).await.map_err(|error| failed(&error))?;
        let Header { owner, signer, .. } = received.header;
        match may_sign(&network.directory, owner, signer, Moment::of_block(block, time)) {
            Ok(SigningRight::Owner(_)) => Ok(None),
            Ok(SigningRight::Device(_)) => Ok(Some((signer, received.signer))),
            Err(why) => Err(Refusal::new(Code::Signature, why)),
        }
    }

    /// Stores what holds: all together, and what has a quota topic by topic, so that one beyond it spoils no other.
    fn keep(&self, proven: Vec<Proven>, refusals: &mut Vec<Refusal>) -> Result<BTreeSet<Numbered>, Refusal> {
        let (mut together, mut by_topic) = (Vec::new(), BTreeMap::<Which, Vec<Proven>>::new());
        let mut admitted = BTreeMap::new();
        for one in proven {
            let (owner, recorder, topic_id, _) = number_of(&one.received.header);
            if let Entry::Vacant(unknown) = admitted.entry(owner) {
                unknown.insert(match self.desk.is_admitted(&owner) {
                    Err(refusal) if matches!(refusal.code, Code::Stale | Code::Internal) => return Err(refusal),
                    // Why not is said when its records are to be kept.
                    found => found.unwrap_or(false),
                });
            }
            if admitted.get(&owner) == Some(&true) {
                together.push(one);
            } else {
                by_topic.entry((owner, recorder, topic_id)).or_default().push(one);
            }
        }
        let mut taken = self.keep_some(None, together, refusals)?;
        for ((owner, ..), some) in by_topic {
            taken.extend(self.keep_some(Some(owner), some, refusals)?);
        }
        Ok(taken)
    }

    /// Those of one owner, or of owners who are admitted; if one contradicts what is here, each of them by itself.
    fn keep_some(
        &self,
        owner: Option<Address>,
        proven: Vec<Proven>,
        refusals: &mut Vec<Refusal>,
    ) -> Result<BTreeSet<Numbered>, Refusal> {
        if proven.is_empty() {
            return Ok(BTreeSet::new());
        }
        let several = proven.len() > 1;
        match self.keep_all(owner, proven.clone()) {
            Err(refusal) if refusal.code == Code::Malformed && several => {
                let mut taken = BTreeSet::new();
                for one in proven {
                    match self.keep_all(owner, vec![one]) {
                        Ok(numbers) => taken.extend(numbers),
                        Err(refusal) => refusals.push(refusal),
                    }
                }
                Ok(taken)
            }
            Err(refusal) if matches!(refusal.code, Code::Stale | Code::Internal) => Err(refusal),
            Err(refusal) => {
                refusals.push(refusal);
                Ok(BTreeSet::new())
            }
            Ok(taken) => Ok(taken),
        }
    }

    fn keep_all(&self, owner: Option<Address>, proven: Vec<Proven>) -> Result<BTreeSet<Numbered>, Refusal> {
        let numbers = proven.iter().map(|one| number_of(&one.received.header)).collect();
        let devices: BTreeMap<SignerId, PublicKey> = proven.iter().filter_map(|one| one.device).collect();
        let (records, anchors): (Vec<_>, Vec<_>) = proven.into_iter().map(|one| (one.received, one.anchor)).unzip();
        let ledger = &self.desk.gateway.plant.ledger;
        let anchor = |rows| ledger.append_anchored(rows, anchors, devices);
        let kept = match owner {
            Some(owner) => self.desk.keep_by(&owner, records, anchor),
            None => self.desk.put_down(records, anchor),
        };
        if kept.is_err() {
            // A block may have been replaced since the chain was asked.
            self.anchors.forget();
        } else {
            self.desk.gateway.hub.confirmed.notify_one();
            self.desk.gateway.hub.changed(Part::Uploads);
        }
        kept.map(|_| numbers)
    }
}

fn number_of(header: &Header) -> Numbered {
    (header.owner, header.recorder, header.topic_id, header.seq)
}

/// What a robot's upload is asked, and that it is one of the records that were asked for.
fn asked_for(network: &Network, wanted: &Wanted, record: &Fetched) -> Result<(), Refusal> {
    let (header, _) = Header::parse(&record.blob)?;
    if header.domain != network.domain {
        return Err(Refusal::new(Code::NotYours, format_args!("record {} is of another network", header.seq)));
    }
    if !wanted.has(&header) {
        return Err(Refusal::new(Code::Malformed, format_args!("record {} was not asked for", header.seq)));
    }
    if signer_id(&record.signer) != header.signer {
        return Err(Refusal::new(Code::Signature, "its header names another key than the one that came with it"));
    }
    Ok(())
}

/// A false proof is the other gateway's fault, everything else is the chain's.
fn failed(error: &PipelineError) -> Refusal {
    let code = if matches!(error, PipelineError::NotTakenIn { .. }) { Code::Tampered } else { Code::Stale };
    Refusal::new(code, error)
}

#[cfg(test)]
#[path = "taking_tests.rs"]
pub(super) mod tests;
