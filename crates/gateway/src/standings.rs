//! The standings of records, signed by the gateway like a receipt: a robot keeps them and may then discard its only
//! copy. In an answer: count (2) || standings (1 each) || time (8) || signature (64) || for each: length (4) || proof.
//! Beside them [`ChainLine`], the chain through a gateway: the chain crate's transport over one connection that
//! reconnects by itself, a visitor's session until there are credentials.

use std::sync::{Arc, PoisonError, RwLock};

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::Mutex;

use crate::chain::{Relay, RelayError};
use crate::client::{Client, Credentials, Endpoint};
use crate::command::answer::LONGEST_PROOF;
use crate::command::request::MOST_CHECKED;
use crate::command::{Relayed, Standing};
use crate::crypto::{CryptoError, Provider, SmKeyPair};
use crate::error::{Code, GatewayError};
use crate::hello::Agreed;
use crate::model::wire::{Reader, WireError};
use crate::model::{Digest, Domain, ProfileName, PublicKey, Signature, Timestamp};
use crate::trust::KeptTrust;

/// The standing of one record, and where the chain has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stood {
    /// Its standing.
    pub standing: Standing,
    /// Proof of the anchor, as written by the chain crate; empty until there is one.
    pub proof: Vec<u8>,
}

/// Standings of records, in the order of the request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignedStandings {
    /// When they were determined.
    pub time: Timestamp,
    /// Each record's standing.
    pub stood: Vec<Stood>,
    /// Signature by the gateway's identity key.
    pub signature: Signature,
}

/// The bytes signed, after the domain: time (8) || count (2) || for each: digest (32) || standing (1) || SM3 of its
/// proof (32, zeros if there is none).
pub fn statement(provider: &dyn Provider, time: Timestamp, digests: &[Digest], stood: &[Stood]) -> Vec<u8> {
    let mut out = time.0.to_be_bytes().to_vec();
    out.extend_from_slice(&u16::try_from(stood.len()).unwrap_or(u16::MAX).to_be_bytes());
    for (digest, one) in digests.iter().zip(stood) {
        out.extend_from_slice(&digest.0);
        out.push(one.standing.code());
        let proof = if one.proof.is_empty() { [0; 32] } else { provider.sm3(&[&one.proof]) };
        out.extend_from_slice(&proof);
    }
    out
}

fn signed_bytes(domain: &Domain, statement: &[u8]) -> Vec<u8> {
    [&b"AuthROS/standing/1"[..], &domain.0, statement].concat()
}

impl SignedStandings {
    /// Signs the standings of these records.
    ///
    /// # Errors
    /// [`CryptoError::Length`] if there are not as many standings as digests, or too many; [`CryptoError::Random`].
    pub fn sign(
        provider: &dyn Provider,
        domain: &Domain,
        identity: &SmKeyPair,
        digests: &[Digest],
        stood: Vec<Stood>,
    ) -> Result<Self, CryptoError> {
        if stood.len() != digests.len() || stood.len() > MOST_CHECKED {
            return Err(CryptoError::Length { what: "standings", found: stood.len(), allowed: "one for each digest" });
        }
        let time = Timestamp::now();
        let signed = signed_bytes(domain, &statement(provider, time, digests, &stood));
        Ok(Self { time, stood, signature: provider.sign(&identity.secret, &signed)? })
    }

    /// Checks the signature for the digests in the request.
    ///
    /// # Errors
    /// [`CryptoError::Length`] if it covers another number of them, [`CryptoError::BadSignature`].
    pub fn verify(
        &self,
        provider: &dyn Provider,
        domain: &Domain,
        gateway: &PublicKey,
        digests: &[Digest],
    ) -> Result<(), CryptoError> {
        if self.stood.len() != digests.len() {
            let found = self.stood.len();
            return Err(CryptoError::Length { what: "standings", found, allowed: "one for each digest" });
        }
        let signed = signed_bytes(domain, &statement(provider, self.time, digests, &self.stood));
        provider.verify(gateway, &signed, &self.signature)
    }

    /// The standings alone.
    pub fn standings(&self) -> Vec<Standing> {
        self.stood.iter().map(|one| one.standing).collect()
    }

    pub(super) fn encode(&self) -> Vec<u8> {
        let stood = &self.stood[..self.stood.len().min(MOST_CHECKED)];
        let count = u16::try_from(stood.len()).unwrap_or(u16::MAX);
        let mut out = count.to_be_bytes().to_vec();
        out.extend(stood.iter().map(|one| one.standing.code()));
        out.extend_from_slice(&self.time.0.to_be_bytes());
        out.extend_from_slice(&self.signature.0);
        for one in stood {
            let proof = &one.proof[..one.proof.len().min(LONGEST_PROOF)];
            out.extend_from_slice(&u32::try_from(proof.len()).unwrap_or(u32::MAX).to_be_bytes());
            out.extend_from_slice(proof);
        }
        out
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let count = usize::from(reader.u16("count")?);
        if count > MOST_CHECKED {
            return Err(WireError::Value("count"));
        }
        let codes = reader.take(count, "standing")?;
        let standings = codes.iter().map(|code| Standing::from_code(*code).ok_or(WireError::Value("standing")));
        let standings = standings.collect::<Result<Vec<_>, _>>()?;
        let (time, signature) = (Timestamp(reader.u64("time")?), Signature(reader.array("signature")?));
        let mut stood = Vec::with_capacity(standings.len());
        for standing in standings {
            let length = usize::try_from(reader.u32("proof length")?).unwrap_or(usize::MAX);
            if length > LONGEST_PROOF {
                return Err(WireError::Value("proof length"));
            }
            stood.push(Stood { standing, proof: reader.take(length, "proof")?.to_vec() });
        }
        Ok(Self { time, stood, signature })
    }
}

/// A client's own requests to the chain behind a gateway.
pub struct ChainLine {
    endpoint: Endpoint,
    trust: Arc<KeptTrust>,
    visitor: ProfileName,
    credentials: RwLock<Option<Credentials>>,
    open: Mutex<Option<Open>>,
}

struct Open {
    client: Client,
    proven: bool,
}

impl ChainLine {
    /// To the gateway at `endpoint`; nothing is sent yet. `visitor` is the name to give before there are credentials.
    pub fn new(endpoint: Endpoint, trust: Arc<KeptTrust>, visitor: ProfileName) -> Self {
        Self { endpoint, trust, visitor, credentials: RwLock::default(), open: Mutex::default() }
    }

    /// The gateway's address.
    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }

    /// From the next request on, acts for an account.
    pub fn prove_by(&self, credentials: Credentials) {
        *self.credentials.write().unwrap_or_else(PoisonError::into_inner) = Some(credentials);
    }

    /// Connects if there is no connection, so that a gateway other than the pinned one can be told from one that does
    /// not answer.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn meet(&self) -> Result<Agreed, GatewayError> {
        let mut open = self.open.lock().await;
        let met = match open.take() {
            Some(met) if !met.client.is_spent() => met,
            _ => self.connect().await?,
        };
        let agreed = *met.client.agreed();
        *open = Some(met);
        Ok(agreed)
    }

    /// Takes its place at the gateway by a small request: before there are credentials, a visitor's.
    ///
    /// # Errors
    /// [`GatewayError`]; `RefusedInClear(Busy)` if visitors have no room.
    pub async fn probe(&self) -> Result<(), GatewayError> {
        self.relay("eth_chainId", &Value::Array(Vec::new())).await.map(drop)
    }

    async fn connect(&self) -> Result<Open, GatewayError> {
        let credentials = self.credentials.read().unwrap_or_else(PoisonError::into_inner).clone();
        let mut trust = self.trust.current();
        if let Some(credentials) = credentials {
            match Client::connect(&self.endpoint, &mut trust, &credentials).await {
                // Replacing a void key is up to its owner; the chain is open to visitors. Other refusals in clear may be
                // forged, and one for want of room would meet a visitor first.
                Err(GatewayError::RefusedInClear(Code::Tag) | GatewayError::Refused(_)) => {
                    self.forget(&credentials);
                }
                connected => {
                    let client = connected?;
                    self.trust.learn(&trust)?;
                    return Ok(Open { client, proven: true });
                }
            }
        }
        let client = Client::visit(&self.endpoint, &mut trust, &self.visitor).await?;
        self.trust.learn(&trust)?;
        Ok(Open { client, proven: false })
    }

    fn forget(&self, void: &Credentials) {
        let mut credentials = self.credentials.write().unwrap_or_else(PoisonError::into_inner);
        credentials.take_if(|credentials| credentials == void);
    }

    async fn relay(&self, method: &str, parameters: &Value) -> Result<Relayed, GatewayError> {
        let mut slot = self.open.lock().await;
        let waiting = self.credentials.read().unwrap_or_else(PoisonError::into_inner).is_some();
        // Taken out meanwhile: a request abandoned halfway must not leave its answer to the next one.
        let kept = slot.take().filter(|open| !open.client.is_spent() && (open.proven || !waiting));
        let reused = kept.is_some();
        let mut open = match kept {
            Some(open) => open,
            None => self.connect().await?,
        };
        let mut relayed = open.client.relay(method, parameters).await;
        // The other end may long since have closed an idle connection. Asking again does no harm: the chain recognises
        // the same transaction, whatever became of the first attempt.
        if reused && !goes_on(&relayed) {
            open = self.connect().await?;
            relayed = open.client.relay(method, parameters).await;
        }
        if goes_on(&relayed) {
            *slot = Some(open);
        }
        relayed
    }
}

/// Whether the session continues after this answer.
fn goes_on(relayed: &Result<Relayed, GatewayError>) -> bool {
    match relayed {
        Ok(_) => true,
        Err(GatewayError::Refused(code)) => !code.ends_session(),
        Err(_) => false,
    }
}

#[async_trait]
impl Relay for ChainLine {
    async fn ask(&self, method: &str, parameters: Value) -> Result<Value, RelayError> {
        let silent = |error: GatewayError| RelayError::Silent(error.to_string());
        let parse = |text: &str| serde_json::from_str(text).map_err(|error| RelayError::Silent(error.to_string()));
        match self.relay(method, &parameters).await {
            Ok(Relayed::Result(result)) => parse(&result),
            Ok(Relayed::Fault { code, words, data }) => {
                let data = if data.is_empty() { None } else { Some(parse(&data)?) };
                Err(RelayError::Answered { code, message: words, data })
            }
            Err(GatewayError::Refused(Code::Method)) => Err(RelayError::NotAllowed),
            Err(error) => Err(silent(error)),
        }
    }

    fn place(&self) -> String {
        format!("the gateway {}", crate::model::clean(&self.endpoint.addresses.join(", "), 300))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{ProviderName, provider};

    #[test]
    fn a_statement_binds_digests_standings_proofs_and_network() {
        let provider = provider(ProviderName::RustCrypto);
        let (identity, domain) = (SmKeyPair::generate(provider).expect("pair"), Domain([4; 32]));
        let digests = [Digest([1; 32]), Digest([2; 32])];
        let stood = |proof: u8| {
            vec![
                Stood { standing: Standing::Verified, proof: vec![proof; 40] },
                Stood { standing: Standing::Acknowledged, proof: Vec::new() },
            ]
        };
        let signed = SignedStandings::sign(provider, &domain, &identity, &digests, stood(7)).expect("signs");
        let holds = |signed: &SignedStandings, domain: &Domain, digests: &[Digest]| {
            signed.verify(provider, domain, &identity.public, digests).is_ok()
        };
        assert!(holds(&signed, &domain, &digests));
        assert!(!holds(&signed, &Domain([5; 32]), &digests));
        assert!(!holds(&signed, &domain, &[digests[1], digests[0]]) && !holds(&signed, &domain, &digests[..1]));
        let mut later = signed.clone();
        later.time.0 += 1;
        let other = SignedStandings { stood: stood(8), ..signed.clone() };
        assert!(!holds(&later, &domain, &digests) && !holds(&other, &domain, &digests));
        let mut better = signed;
        better.stood[1].standing = Standing::Verified;
        assert!(!holds(&better, &domain, &digests));
        assert!(SignedStandings::sign(provider, &domain, &identity, &digests[..1], stood(7)).is_err());
    }
}
