//! Owners of the simulated robots: accounts with throw-away keys, registered on the chain, who lend each robot's key.

use std::collections::HashSet;
use std::net::IpAddr;
use std::time::{Duration, Instant};

use super::robot::{Access, Scene};
use crate::network::{receipt, settle};
use authros_chain::{Call, Chain};
use authros_crypto::{EoaSecret, EpochKey, Sm4Key, SmKeyPair, epoch_key, prove, random_bytes, token};
use authros_gateway::{Endpoint, Entry, Query, Selection, Trust};
use authros_model::{Address, ErrorKind, SignerId, Timestamp, Token};
use authros_service::Failure;
use authros_service::failure::internal;

/// Entries of a page.
const PAGE: u16 = 500;
/// Characters of its account in the name under which an owner is known.
const OF_ACCOUNT: usize = 18;
/// How long an answer may take.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long a refusal is answered by asking again, and the pause before that.
const ASKED_AGAIN: Duration = Duration::from_secs(60);
const PAUSE: Duration = Duration::from_secs(1);

/// An owner.
pub(super) struct Owner {
    /// Its account.
    pub eoa: EoaSecret,
    /// The account's address.
    pub address: Address,
    /// The token of its only epoch.
    pub token: Token,
    /// (d_C, P_C).
    pub signing: SmKeyPair,
    /// (d_E, P_E).
    pub envelope: SmKeyPair,
    /// EK of its only epoch.
    pub epoch: EpochKey,
    /// Its address on the network.
    pub source: IpAddr,
}

impl Owner {
    /// A new one, registered.
    ///
    /// # Errors
    /// Errors of the chain.
    pub async fn registered(scene: &Scene, chain: &Chain, source: IpAddr) -> Result<Self, Failure> {
        let (provider, domain) = (scene.context.provider, scene.context.domain);
        let eoa = EoaSecret::generate()?;
        let address = eoa.address();
        let epoch = epoch_key(&Sm4Key::generate()?, &random_bytes()?, &domain, &address, 1);
        let token = token(&domain, &address, 1, &epoch);
        let (signing, envelope) = (SmKeyPair::generate(provider)?, SmKeyPair::generate(provider)?);
        let identity = prove(provider, &domain, &address, &signing, &envelope.public, token)?;
        let signed = chain.sign(&eoa, 0, &Call::Register { identity }).await?;
        settle(chain, signed).await?;
        Ok(Self { eoa, address, token, signing, envelope, epoch, source })
    }

    /// Lends keys, for good; returns when all loans are in blocks.
    ///
    /// # Errors
    /// Errors of the chain.
    pub async fn lend(&self, chain: &Chain, devices: &[SignerId]) -> Result<(), Failure> {
        let mut last = None;
        // The registration took nonce 0.
        for (nonce, device) in (1..).zip(devices) {
            let signed = chain.sign(&self.eoa, nonce, &Call::Lend { device: *device, until: None }).await?;
            chain.broadcast(&signed.raw).await?;
            last = Some(signed.hash);
        }
        let Some(last) = last else { return Ok(()) };
        if receipt(chain, last).await?.success {
            return Ok(());
        }
        Err(Failure::new(ErrorKind::Refused, "the chain refused to lend a robot's key"))
    }

    /// Everything of this owner that a gateway lists; one that just began again, or waits for a block, is asked again.
    ///
    /// # Errors
    /// Errors of the gateway.
    pub async fn list(&self, scene: &Scene, place: usize) -> Result<Vec<Entry>, Failure> {
        let begun = Instant::now();
        loop {
            match self.listed(scene, place).await {
                Err(_) if begun.elapsed() < ASKED_AGAIN => tokio::time::sleep(PAUSE).await,
                told => return told,
            }
        }
    }

    async fn listed(&self, scene: &Scene, place: usize) -> Result<Vec<Entry>, Failure> {
        let (address, key) = scene.places.get(place).ok_or_else(|| internal("no such gateway"))?;
        let endpoint = Endpoint { address: address.clone(), context: scene.context, patience: PATIENCE };
        let account = self.address.to_string().to_lowercase();
        let name = crate::read(&format!("owner-{}", account.get(2..OF_ACCOUNT).unwrap_or_default()))?;
        let mut access = Access::allocate(&endpoint, Trust::pinned(*key), (self.source, &name), self).await?;
        let mut client = access.connect(&endpoint, self.source).await?;
        let mut entries = Vec::new();
        let mut query = Query {
            selection: Selection::all(self.address),
            from: Timestamp(0),
            until: Timestamp(u64::MAX),
            cursor: 0,
            limit: PAGE,
        };
        let mut cursors = HashSet::new();
        loop {
            let page = client.query(&query).await?;
            entries.extend(page.entries);
            let Some(next) = page.next else { return Ok(entries) };
            if !cursors.insert(next) {
                return Err(internal("a gateway's list does not end"));
            }
            query.cursor = next;
        }
    }
}
