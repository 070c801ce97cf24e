//! Bundles made for measuring: records sealed by the real code, anchored in batches on an embedded chain, each batch
//! with the chain's own proofs, taken at its block.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use authros_chain::merkle::Tree;
use authros_chain::{Call, Consensus};
use authros_crypto::{EoaSecret, Provider, pool};
use authros_evidence::{
    AnchorClaim, Anchoring, BundledRecord, ClaimedChain, Nodes, Packing, PinnedChain, Slot, Trust, pack,
};
use authros_model::{Address, ErrorKind, Identity};
use authros_service::Failure;
use authros_service::failure::internal;
use tokio::task::block_in_place;

use crate::account::{Account, Sealed, message};
use crate::network::{Directory, Network, Place, join, settle};

/// Bytes of each message.
pub(super) const MESSAGE: usize = 1024;
/// The version of keys that were never changed.
const FIRST_KEYS: u64 = 1;

/// An embedded chain, and what a reader pins of it.
pub(super) struct Ground {
    pub network: Network,
    pub trust: Trust,
    pub provider: &'static dyn Provider,
    claimed: ClaimedChain,
    _directory: Directory,
}

/// Records in one batch, anchored.
pub(super) struct Batch {
    /// Each with its signer.
    records: Vec<(Arc<Account>, Sealed)>,
    tree: Tree,
    anchorer: Address,
    block: u64,
    header: Vec<u8>,
}

/// Nodes of the state, each once.
pub(super) type Proofs = BTreeSet<Vec<u8>>;

/// A bundle, and of what it consists.
pub(super) struct Made {
    /// The file.
    pub file: Vec<u8>,
    /// Bytes of the state's nodes in it.
    pub nodes: usize,
    /// Bytes of the blocks' headers in it.
    pub headers: usize,
}

impl Ground {
    /// A new chain with two registered accounts.
    ///
    /// # Errors
    /// If it cannot be made.
    pub async fn new(provider: &'static dyn Provider) -> Result<Self, Failure> {
        let consensus = Consensus::Poa { signers: 1, period: Duration::ZERO };
        let directory = Directory::new()?;
        let network = Network::open(&Place::Embedded(consensus), provider, directory.path(), None).await?;
        let pin = network.chain.pin().ok_or_else(|| internal("the contract is not deployed"))?;
        let claimed = ClaimedChain { id: pin.chain_id, genesis: pin.genesis, contract: pin.contract };
        let signers = network.chain.sealing().await?.sealers;
        let chain = PinnedChain {
            id: pin.chain_id,
            genesis: pin.genesis,
            contract: pin.contract,
            code_hash: pin.code_hash,
            signers,
            quorum: None,
            sealed_by_exporter: true,
        };
        let trust = Trust { chain, persons: Vec::new(), authorities: Vec::new() };
        Ok(Self { network, trust, provider, claimed, _directory: directory })
    }

    /// The account that owns the records of one signer, and exports.
    pub fn owner(&self) -> &Arc<Account> {
        &self.network.accounts[0]
    }

    /// Further registered accounts.
    ///
    /// # Errors
    /// Errors of the chain.
    pub async fn register(&self, count: usize) -> Result<Vec<Arc<Account>>, Failure> {
        let mut accounts = Vec::with_capacity(count);
        for _ in 0..count {
            accounts.push(Arc::new(join(&self.network.chain, EoaSecret::generate()?, self.provider).await?));
        }
        Ok(accounts)
    }

    /// Seals a message of each signer, in order, and anchors them as one batch by `anchorer`.
    ///
    /// # Errors
    /// Errors of the chain.
    pub async fn anchor(&self, signers: &[Arc<Account>], anchorer: &Account) -> Result<Batch, Failure> {
        let body = message(MESSAGE)?;
        let helpers = pool::helpers_for(signers.len(), signers.len() * MESSAGE);
        let sealed = block_in_place(|| pool::each(signers, helpers, |signer| signer.seal(&body)));
        let sealed = sealed.into_iter().collect::<Result<Vec<Sealed>, Failure>>()?;
        let tree = Tree::new(sealed.iter().map(|one| one.leaf.hash()).collect());
        let tree = tree.ok_or_else(|| internal("a batch has no leaves, or too many"))?;
        let chain = &self.network.chain;
        let previous = chain.anchor_head(anchorer.address).await?;
        let call = Call::Anchor { root: tree.root(), count: sealed.len() as u64, previous };
        let block = settle(chain, chain.sign(&anchorer.eoa, anchorer.next_nonce(), &call).await?).await?.block;
        let header = chain.header_rlp(block).await?.ok_or_else(|| internal("the anchoring block is missing"))?;
        let records = signers.iter().cloned().zip(sealed).collect();
        Ok(Batch { records, tree, anchorer: anchorer.address, block, header })
    }

    /// Asks the chain for the proofs of a batch, after its own block; the chain has that state for 128 blocks.
    ///
    /// # Errors
    /// Errors of the chain.
    pub async fn prove(&self, batch: &Batch, proofs: &mut Proofs) -> Result<(), Failure> {
        let slots = batch.slots();
        proofs.extend(self.network.chain.storage_nodes(batch.block, &slots).await?);
        Ok(())
    }

    /// The identities of these accounts, as the chain has them.
    ///
    /// # Errors
    /// Errors of the chain.
    pub async fn identities(&self, accounts: &[Arc<Account>]) -> Result<Vec<Identity>, Failure> {
        let mut found = Vec::with_capacity(accounts.len());
        for account in accounts {
            let state = self.network.chain.account(account.address).await?;
            found.push(state.ok_or_else(|| internal("an account is not registered"))?.identity);
        }
        Ok(found)
    }

    /// The bundle of these batches.
    ///
    /// # Errors
    /// If it would be larger than a bundle can be.
    pub fn pack(&self, batches: &[Batch], proofs: &Proofs, identities: &[Identity]) -> Result<Made, Failure> {
        let refused = |error: authros_evidence::PackingError| Failure::new(ErrorKind::Input, error.to_string());
        let mut packing = Packing::default();
        let mut keys = BTreeMap::new();
        for batch in batches {
            packing.header(batch.block, batch.header.clone());
            for (index, (signer, sealed)) in batch.records.iter().enumerate() {
                keys.insert(signer.address, signer.signing().public);
                packing.record(sealed.leaf.digest, batch.bundled(index, sealed)).map_err(refused)?;
            }
        }
        for key in keys.values() {
            packing.key(key).map_err(refused)?;
        }
        identities.iter().for_each(|identity| packing.identity(identity));
        let nodes: Nodes = proofs.iter().cloned().collect();
        packing.nodes(&nodes);
        packing.suggest(&self.trust).map_err(refused)?;
        let owner = self.owner();
        let members = packing.sign(self.claimed.clone(), owner.address, owner.signing(), self.provider);
        let file = pack(&members.map_err(refused)?).map_err(refused)?;
        let headers = batches.iter().map(|batch| batch.header.len()).sum();
        Ok(Made { file, nodes: nodes.encode().len(), headers })
    }
}

impl Batch {
    /// Its records and their signers.
    pub fn records(&self) -> &[(Arc<Account>, Sealed)] {
        &self.records
    }

    /// What the state has to show, as an export asks for it: the anchor; and of each owner the standing, a loan, the
    /// keys in force and that there are no newer ones.
    fn slots(&self) -> Vec<Slot> {
        let mut slots = BTreeSet::from([Slot::anchor(self.anchorer, self.tree.root()).0]);
        for (signer, _) in &self.records {
            let (owner, device) = (signer.address, authros_crypto::signer_id(&signer.signing().public));
            let (keys, newer) = (Slot::keys(owner, FIRST_KEYS), Slot::keys(owner, FIRST_KEYS + 1));
            slots.extend([Slot::account(owner), Slot::loan(owner, &device.0)].map(|slot| slot.0));
            slots.extend([keys, keys.next(1), newer, newer.next(1)].map(|slot| slot.0));
        }
        slots.into_iter().map(Slot).collect()
    }

    fn bundled(&self, index: usize, sealed: &Sealed) -> BundledRecord {
        let anchor = Anchoring::Batch {
            account: self.anchorer,
            root: self.tree.root(),
            index: index as u64,
            count: self.records.len() as u64,
            path: self.tree.path(index),
        };
        let claim = AnchorClaim::new(self.block, self.block, FIRST_KEYS, anchor);
        let (record, signature) = (sealed.blob.clone(), sealed.signature);
        BundledRecord { record, signature, anchor: Some(claim), disclosure: None }
    }
}
