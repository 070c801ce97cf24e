//! A simulated robot: a client of the gateway's protocol with a lent key, a recorder and a network address of its own,
//! known to its home gateway and to the next one. It brings what it sealed, and fails over as a robot does.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::owner::Owner;
use crate::account::{head, message};
use authros_crypto::{SealRequest, SmKeyPair, TopicKey, random_bytes, seal, signer_id, topic_key};
use authros_gateway::{Applicant, Client, Context, Credentials, DeviceNotice, Endpoint, GatewayError, Trust, Upload};
use authros_model::{Digest, ProfileName, RecordKind, RecorderId, SignerId, Timestamp, TopicId};
use authros_service::Failure;
use authros_service::failure::internal;

/// Records in one upload.
pub(super) const TOGETHER: usize = 8;
/// How long an answer may take a robot that has another gateway to turn to.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long a new robot waits until all gateways have heard of it from the chain.
const KNOWN: Duration = Duration::from_secs(120);
/// The pause before the next gateway is tried, and between looks at whether to hurry.
const PAUSE: Duration = Duration::from_millis(50);
/// Addresses in each part of 127/8.
const ADDRESSES: u32 = 250;

/// What all robots share.
pub(super) struct Scene {
    /// Network and provider.
    pub context: Context,
    /// Address and key of each gateway.
    pub places: Vec<(String, SignerId)>,
}

impl Scene {
    fn endpoint(&self, place: usize) -> Result<(Endpoint, SignerId), Failure> {
        let (address, key) = self.places.get(place).ok_or_else(|| internal("no such gateway"))?;
        Ok((Endpoint { address: address.clone(), context: self.context, patience: PATIENCE }, *key))
    }
}

/// The loopback address of a number: a gateway limits each address by itself, and robots have one each.
pub(super) fn source(part: u8, number: u32) -> IpAddr {
    let byte = |value: u32| u8::try_from(value % ADDRESSES).unwrap_or(0) + 1;
    let high = part.saturating_add(u8::try_from(number / ADDRESSES / ADDRESSES).unwrap_or(u8::MAX));
    IpAddr::V4(Ipv4Addr::new(127, high, byte(number / ADDRESSES), byte(number)))
}

/// What a client keeps of one gateway.
pub(super) struct Access {
    credentials: Credentials,
    trust: Trust,
}

impl Access {
    /// A transport key for a name of this owner.
    ///
    /// # Errors
    /// Errors of the gateway.
    pub async fn allocate(
        endpoint: &Endpoint,
        mut trust: Trust,
        (source, name): (IpAddr, &ProfileName),
        owner: &Owner,
    ) -> Result<Self, GatewayError> {
        let envelope = owner.envelope.public;
        let applicant = Applicant { name, signing: &owner.signing, envelope, account: &owner.eoa };
        let (key, _) = Client::allocate_from(Some(source), endpoint, &mut trust, &applicant).await?;
        Ok(Self { credentials: Credentials { name: name.clone(), key, token: owner.token }, trust })
    }

    /// A session.
    ///
    /// # Errors
    /// Errors of the gateway.
    pub async fn connect(&mut self, endpoint: &Endpoint, source: IpAddr) -> Result<Client, GatewayError> {
        Client::connect_from(Some(source), endpoint, &mut self.trust, &self.credentials).await
    }
}

/// A record that is sealed and not yet brought anywhere.
pub(super) struct Sealed {
    digest: Digest,
    upload: Upload,
}

/// How fast robots bring their records, and until when.
pub(super) struct Pace {
    /// What is not brought by then stays where it is, and is counted.
    pub deadline: Instant,
    /// The pause between two uploads.
    pub rest: Duration,
    /// There is nothing to wait for any more.
    pub hurry: AtomicBool,
}

impl Pace {
    async fn rest(&self) {
        let until = Instant::now() + self.rest;
        while Instant::now() < until && !self.hurry.load(Ordering::Relaxed) {
            tokio::time::sleep(PAUSE.min(self.rest)).await;
        }
    }
}

/// What came of the records of one robot, or of several.
#[derive(Default)]
pub(super) struct Brought {
    /// Records with a receipt.
    pub acknowledged: Vec<Digest>,
    /// From sending an upload to its receipt, milliseconds.
    pub waits: Vec<f64>,
    /// From the request that failed to the receipt of another gateway, seconds.
    pub failovers: Vec<f64>,
    /// Records without a receipt when the time was over, and why the last one had none.
    pub left: u64,
    /// The last error.
    pub why: Option<String>,
}

impl Brought {
    /// Adds what another robot brought.
    pub fn add(&mut self, other: Self) {
        self.acknowledged.extend(other.acknowledged);
        self.waits.extend(other.waits);
        self.failovers.extend(other.failovers);
        self.left += other.left;
        self.why = other.why.or(self.why.take());
    }
}

/// The session of a turn.
#[derive(Default)]
struct Line {
    at: usize,
    client: Option<Client>,
    /// When the request was made that failed.
    broken: Option<Instant>,
}

/// A robot.
pub(super) struct Robot {
    owner: Arc<Owner>,
    name: ProfileName,
    device: SmKeyPair,
    recorder: RecorderId,
    topic: TopicId,
    key: TopicKey,
    next: u64,
    source: IpAddr,
    /// Its gateways, home first.
    places: Vec<(usize, Access)>,
}

impl Robot {
    /// The one with this number, with a fresh key that is not lent yet.
    ///
    /// # Errors
    /// Errors of the random source.
    pub fn new(scene: &Scene, owner: Arc<Owner>, number: u32) -> Result<Self, Failure> {
        let topic = TopicId(random_bytes()?);
        Ok(Self {
            name: crate::read(&format!("robot-{number}"))?,
            device: SmKeyPair::generate(scene.context.provider)?,
            recorder: RecorderId(random_bytes()?),
            key: topic_key(&owner.epoch, &topic),
            topic,
            owner,
            next: 1,
            source: source(1, number),
            places: Vec::new(),
        })
    }

    /// SM3 of its public key, as it is lent.
    pub fn device(&self) -> SignerId {
        signer_id(&self.device.public)
    }

    /// Makes it known to these gateways, home first.
    ///
    /// # Errors
    /// The last refusal, if a gateway does not accept it in time.
    pub async fn introduce(&mut self, scene: &Scene, places: &[usize]) -> Result<(), Failure> {
        for place in places {
            let (endpoint, key) = scene.endpoint(*place)?;
            let begun = Instant::now();
            let access = loop {
                match self.introduced(&endpoint, key).await {
                    Ok(access) => break access,
                    // Its watcher has not come to the registration, or to the loan.
                    Err(_) if begun.elapsed() < KNOWN => tokio::time::sleep(PAUSE).await,
                    Err(error) => return Err(error.into()),
                }
            };
            self.places.push((*place, access));
        }
        Ok(())
    }

    async fn introduced(&self, endpoint: &Endpoint, key: SignerId) -> Result<Access, GatewayError> {
        let who = (self.source, &self.name);
        let mut access = Access::allocate(endpoint, Trust::pinned(key), who, &self.owner).await?;
        let mut client = access.connect(endpoint, self.source).await?;
        let notices = TopicId([0; 16]);
        client.device(&self.owner.signing, DeviceNotice { key: self.device.public, notices }).await?;
        Ok(access)
    }

    /// Seals its next records, of random bytes.
    ///
    /// # Errors
    /// Errors of the random source.
    pub fn seal(&mut self, scene: &Scene, count: u64, bytes: usize) -> Result<Vec<Sealed>, Failure> {
        let (head, first) = (head(bytes), self.next);
        self.next += count;
        let one = |seq: u64| {
            let request = SealRequest {
                domain: scene.context.domain,
                owner: self.owner.address,
                signer: &self.device,
                epoch: 1,
                topic_key: &self.key,
                recorder: self.recorder,
                seq,
                topic_id: self.topic,
                kind: RecordKind::Data,
                filters: Vec::new(),
                captured_at: Timestamp::now(),
                head: &head,
                body: &message(bytes)?,
            };
            let sealed = seal(scene.context.provider, &request)?;
            Ok(Sealed { digest: sealed.digest, upload: Upload::from(&sealed) })
        };
        (first..first + count).map(one).collect()
    }

    /// Brings these records to its home, or to the next gateway while that is away.
    pub async fn bring(&mut self, scene: &Scene, sealed: &[Sealed], pace: &Pace) -> Brought {
        let (mut brought, mut line) = (Brought::default(), Line::default());
        for some in sealed.chunks(TOGETHER) {
            let begun = Instant::now();
            let mut there = false;
            while !there && Instant::now() < pace.deadline {
                let tried = Instant::now();
                match self.attempt(scene, &mut line, some).await {
                    Ok(()) => there = true,
                    Err(error) => {
                        line.client = None;
                        line.broken.get_or_insert(tried);
                        line.at = (line.at + 1) % self.places.len().max(1);
                        brought.why = Some(error.message);
                        tokio::time::sleep(PAUSE).await;
                    }
                }
            }
            if there {
                brought.failovers.extend(line.broken.take().map(|broken| broken.elapsed().as_secs_f64()));
                brought.waits.push(begun.elapsed().as_secs_f64() * 1e3);
                brought.acknowledged.extend(some.iter().map(|one| one.digest));
            } else {
                brought.left += some.len() as u64;
            }
            pace.rest().await;
        }
        brought
    }

    async fn attempt(&mut self, scene: &Scene, line: &mut Line, some: &[Sealed]) -> Result<(), Failure> {
        let source = self.source;
        let client = match &mut line.client {
            Some(client) => client,
            None => {
                let (place, access) = self.places.get_mut(line.at).ok_or_else(|| internal("a robot has no gateway"))?;
                let (endpoint, _) = scene.endpoint(*place)?;
                line.client.insert(access.connect(&endpoint, source).await?)
            }
        };
        client.upload(some.iter().map(|one| one.upload.clone()).collect()).await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn each_robot_has_an_address_of_its_own_on_the_loopback() {
        let all: BTreeSet<IpAddr> = (0..100_000).map(|number| source(1, number)).collect();
        assert_eq!(all.len(), 100_000);
        assert!(all.iter().all(IpAddr::is_loopback) && !all.contains(&source(100, 0)));
        assert_eq!(source(1, 0), IpAddr::V4(Ipv4Addr::new(127, 1, 1, 1)));
    }
}
