//! Calls of the contract and their encoding.

use std::sync::LazyLock;

use ethers::abi::{Abi, Function, Token as AbiToken};
use ethers::types::{H160, U256};
use ethers::utils::keccak256;
use serde::Deserialize;

use crate::model::{Address, Digest, Hash, Identity, Scope, SignerId, Timestamp, Token, TopicId, bytes::unhex};
use crate::{ChainError, model::grant::MOST_TOPICS};

/// The most grantees in one [`Call::Wrap`] (contract limit).
pub const MOST_WRAPS: usize = 32;
/// The longest envelope, bytes (contract limit).
pub const LONGEST_ENVELOPE: usize = 4096;

/// A change of the contract's state, made by the sender of the transaction.
#[derive(Debug, Clone, PartialEq, Eq, strum::IntoStaticStr)]
#[strum(serialize_all = "camelCase")]
pub enum Call {
    /// Registers the sender at epoch 1. The envelope wraps the epoch's key for the sender; empty if it seals nothing.
    Register { identity: Identity, envelope: Vec<u8> },
    /// Replaces the sender's SM2 keys within the epoch. The envelope wraps the new keys for the old ones.
    RotateKeys { identity: Identity, envelope: Vec<u8> },
    /// Uploads the digest of one record, with any token that the sender has ever registered.
    DataUpload { digest: Digest, token: Token, timestamp: Timestamp },
    /// Lets a grantee read until `expiry`, whole seconds; `None` = no end.
    AuthorityGrant { grantee: Address, epoch: u64, expiry: Option<Timestamp>, scope: Scope, envelope: Vec<u8> },
    /// Gives grantees the envelopes of another epoch, at most [`MOST_WRAPS`].
    Wrap { epoch: u64, envelopes: Vec<(Address, Vec<u8>)> },
    /// Ends a grant and the epoch.
    AuthorityRevoke { grantee: Address, new_token: Token, envelope: Vec<u8> },
    /// Ends the epoch.
    Rotate { new_token: Token, envelope: Vec<u8> },
    /// `previous` is the sender's last root, zero for the first.
    Anchor { root: Hash, count: u64, previous: Hash },
    /// `device` is the SM3 of its public key; `until` is in whole seconds.
    Lend { device: SignerId, until: Option<Timestamp> },
    /// Ends a device's loan.
    Recall { device: SignerId },
    /// Administrator: lets an account register while registration is closed.
    Admit { account: Address },
    /// Administrator.
    Dismiss { account: Address },
    /// Administrator: opens or closes registration.
    SetOpen { open: bool },
    /// Administrator: suspends an account's changes.
    Suspend { account: Address },
    /// Administrator: ends a suspension.
    Restore { account: Address },
    /// Administrator: pauses all changes except those that take rights away, at most [`super::LONGEST_PAUSE`] ahead.
    Pause { until: Timestamp },
    /// Administrator: ends the pause.
    Resume,
    /// Administrator.
    ProposeSuccession { lost: Address, successor: Address },
    /// Recovery account or administrator.
    CancelSuccession { lost: Address },
    /// Anyone, once the delay is over.
    CompleteSuccession { lost: Address },
    /// `None` = nobody may stop a succession of the sender.
    NameRecovery { recovery: Option<Address> },
    /// Whole seconds; `None` = no end.
    Extend { grantee: Address, expiry: Option<Timestamp> },
    /// The zero address withdraws the nomination.
    Nominate { account: Address },
    /// By the nominee.
    AcceptAdministrator,
}

impl Call {
    pub fn name(&self) -> &'static str {
        self.into()
    }

    pub fn encode(&self) -> Result<Vec<u8>, ChainError> {
        artefact()?.encode(self.name(), &self.arguments()?)
    }

    fn arguments(&self) -> Result<Vec<AbiToken>, ChainError> {
        Ok(match self {
            Self::Register { identity, envelope } | Self::RotateKeys { identity, envelope } => {
                vec![AbiToken::Bytes(identity.encode()), own(envelope)?]
            }
            Self::DataUpload { digest, token, timestamp } => {
                let fields = [&digest.0[..], &token.0, &timestamp.0.to_be_bytes()];
                fields.iter().map(|field| AbiToken::Bytes(field.to_vec())).collect()
            }
            Self::AuthorityGrant { grantee, epoch, expiry, scope, envelope } => vec![
                address(*grantee),
                number(*epoch),
                number(seconds(*expiry)?),
                topics(scope)?,
                AbiToken::Bytes(bounded(envelope)?),
            ],
            Self::Wrap { epoch, envelopes } => wrap(*epoch, envelopes)?,
            Self::AuthorityRevoke { grantee, new_token, envelope } => {
                vec![address(*grantee), word(new_token.0), own(envelope)?]
            }
            Self::Rotate { new_token, envelope } => vec![word(new_token.0), own(envelope)?],
            Self::Anchor { root, count, previous } => vec![word(root.0), number(*count), word(previous.0)],
            Self::Lend { device, until } => vec![word(device.0), number(seconds(*until)?)],
            Self::Recall { device } => vec![word(device.0)],
            Self::SetOpen { open } => vec![AbiToken::Bool(*open)],
            Self::Admit { account }
            | Self::Dismiss { account }
            | Self::CancelSuccession { lost: account }
            | Self::CompleteSuccession { lost: account }
            | Self::Suspend { account }
            | Self::Restore { account }
            | Self::Nominate { account } => {
                vec![address(*account)]
            }
            Self::Pause { until } => vec![number(seconds(Some(*until))?)],
            Self::NameRecovery { recovery } => vec![address(recovery.unwrap_or(Address([0; 20])))],
            Self::Extend { grantee, expiry } => vec![address(*grantee), number(seconds(*expiry)?)],
            Self::ProposeSuccession { lost, successor } => vec![address(*lost), address(*successor)],
            Self::AcceptAdministrator | Self::Resume => Vec::new(),
        })
    }
}

pub(super) fn address(address: Address) -> AbiToken {
    AbiToken::Address(H160(address.0))
}

pub(super) fn word(bytes: [u8; 32]) -> AbiToken {
    AbiToken::FixedBytes(bytes.to_vec())
}

fn number(value: u64) -> AbiToken {
    AbiToken::Uint(U256::from(value))
}

/// Whole seconds, 0 for never. A fraction is refused: the chain would show another end than the signed one.
fn seconds(end: Option<Timestamp>) -> Result<u64, ChainError> {
    match end {
        None => Ok(0),
        Some(end) if end.seconds() > 0 && Timestamp::from_seconds(end.seconds()) == end => Ok(end.seconds()),
        Some(end) => Err(ChainError::Input(format!("the end {end} is not a whole second; round it to the second"))),
    }
}

fn topics(scope: &Scope) -> Result<AbiToken, ChainError> {
    let topics: &[_] = match scope {
        Scope::All => &[],
        Scope::Topics(topics) if topics.is_empty() || topics.len() > MOST_TOPICS => {
            let found = topics.len();
            return Err(ChainError::Input(format!("a grant names 1 to {MOST_TOPICS} topics, not {found}, or all")));
        }
        Scope::Topics(topics) => topics,
    };
    Ok(AbiToken::Array(topics.iter().map(|topic| AbiToken::FixedBytes(topic.0.to_vec())).collect()))
}

fn bounded(envelope: &[u8]) -> Result<Vec<u8>, ChainError> {
    if envelope.is_empty() || envelope.len() > LONGEST_ENVELOPE {
        let found = envelope.len();
        let advice = "grant fewer topics or epochs";
        return Err(ChainError::Input(format!("an envelope has 1 to {LONGEST_ENVELOPE} bytes, not {found}; {advice}")));
    }
    Ok(envelope.to_vec())
}

/// Accounts that seal nothing have no envelope.
fn own(envelope: &[u8]) -> Result<AbiToken, ChainError> {
    if envelope.is_empty() { Ok(AbiToken::Bytes(Vec::new())) } else { bounded(envelope).map(AbiToken::Bytes) }
}

fn wrap(epoch: u64, envelopes: &[(Address, Vec<u8>)]) -> Result<Vec<AbiToken>, ChainError> {
    if envelopes.is_empty() || envelopes.len() > MOST_WRAPS {
        let found = envelopes.len();
        return Err(ChainError::Input(format!("one call wraps for 1 to {MOST_WRAPS} grantees, not {found}; split it")));
    }
    let grantees = envelopes.iter().map(|(grantee, _)| address(*grantee)).collect();
    let bytes = envelopes.iter().map(|(_, envelope)| bounded(envelope).map(AbiToken::Bytes));
    Ok(vec![AbiToken::Array(grantees), number(epoch), AbiToken::Array(bytes.collect::<Result<_, _>>()?)])
}

/// Values of the contract, in order.
pub(super) struct Values(std::vec::IntoIter<AbiToken>);

impl Values {
    pub(super) fn new(values: Vec<AbiToken>) -> Self {
        Self(values.into_iter())
    }

    pub(super) fn address(&mut self) -> Option<Address> {
        self.0.next()?.into_address().map(|address| Address(address.0))
    }

    /// The zero address means nobody.
    #[allow(clippy::option_option, reason = "no word left is another thing than nobody")]
    pub(super) fn somebody(&mut self) -> Option<Option<Address>> {
        self.address().map(|address| (address.0 != [0; 20]).then_some(address))
    }

    pub(super) fn flag(&mut self) -> Option<bool> {
        self.0.next()?.into_bool()
    }

    pub(super) fn number(&mut self) -> Option<u64> {
        self.0.next()?.into_uint()?.try_into().ok()
    }

    pub(super) fn moment(&mut self) -> Option<Timestamp> {
        self.number().map(Timestamp::from_seconds)
    }

    /// What the sender claims; the inner `None` if it is not 8 bytes.
    #[allow(clippy::option_option, reason = "no word left is another thing than no time")]
    pub(super) fn claim(&mut self) -> Option<Option<Timestamp>> {
        Some(self.bytes()?.try_into().ok().map(|bytes| Timestamp(u64::from_be_bytes(bytes))))
    }

    /// 0 means no end.
    #[allow(clippy::option_option, reason = "no word left is another thing than no end")]
    pub(super) fn end(&mut self) -> Option<Option<Timestamp>> {
        self.number().map(|seconds| (seconds != 0).then(|| Timestamp::from_seconds(seconds)))
    }

    pub(super) fn word(&mut self) -> Option<[u8; 32]> {
        self.0.next()?.into_fixed_bytes()?.try_into().ok()
    }

    pub(super) fn hash(&mut self) -> Option<Hash> {
        self.word().map(Hash)
    }

    pub(super) fn digest(&mut self) -> Option<Digest> {
        self.word().map(Digest)
    }

    pub(super) fn token(&mut self) -> Option<Token> {
        self.word().map(Token)
    }

    pub(super) fn device(&mut self) -> Option<SignerId> {
        self.word().map(SignerId)
    }

    pub(super) fn bytes(&mut self) -> Option<Vec<u8>> {
        self.0.next()?.into_bytes()
    }

    pub(super) fn identity(&mut self) -> Option<Identity> {
        Identity::parse(&self.bytes()?).ok()
    }

    /// No topics mean all.
    pub(super) fn scope(&mut self) -> Option<Scope> {
        let ids = self.0.next()?.into_array()?.into_iter();
        let topics = ids.map(|id| TopicId::from_slice(&id.into_fixed_bytes()?)).collect::<Option<Vec<_>>>()?;
        Some(if topics.is_empty() { Scope::All } else { Scope::Topics(topics) })
    }
}

// The compiled contract built into this program.

const ARTEFACT: &str = include_str!("../../../contracts/AuthROS.json");

#[derive(Debug)]
pub struct Artefact {
    pub abi: Abi,
    /// Without the constructor's arguments.
    pub creation: Vec<u8>,
    /// Keccak-256 of the deployed code.
    pub code_hash: Hash,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct File {
    abi: Abi,
    bytecode: String,
    deployed_bytecode: String,
}

static READ: LazyLock<Result<Artefact, String>> = LazyLock::new(|| read(ARTEFACT));

fn read(json: &str) -> Result<Artefact, String> {
    let file: File = serde_json::from_str(json).map_err(|error| format!("the contract's artefact: {error}"))?;
    let code = |text: &str| unhex(text).ok_or_else(|| "the contract's artefact is not hex".to_owned());
    Ok(Artefact {
        creation: code(&file.bytecode)?,
        code_hash: Hash(keccak256(code(&file.deployed_bytecode)?)),
        abi: file.abi,
    })
}

pub fn artefact() -> Result<&'static Artefact, ChainError> {
    READ.as_ref().map_err(|error| ChainError::Internal(error.clone()))
}

impl Artefact {
    pub fn function(&self, name: &str) -> Result<&Function, ChainError> {
        self.abi.function(name).map_err(|error| ChainError::Internal(format!("{name}: {error}")))
    }

    pub fn encode(&self, name: &str, arguments: &[AbiToken]) -> Result<Vec<u8>, ChainError> {
        let encoded = self.function(name)?.encode_input(arguments);
        encoded.map_err(|error| ChainError::Internal(format!("{name}: {error}")))
    }

    /// The first topic of an event.
    pub fn event_signature(&self, name: &str) -> Result<Hash, ChainError> {
        let event = self.abi.event(name).map_err(|error| ChainError::Internal(format!("{name}: {error}")))?;
        Ok(Hash(event.signature().0))
    }

    /// Creation code for open or closed registration, and a succession delay in seconds.
    pub fn creation(&self, open: bool, delay: u64) -> Result<Vec<u8>, ChainError> {
        let constructor = self.abi.constructor().ok_or_else(|| ChainError::Internal("no constructor".into()))?;
        let arguments = [AbiToken::Bool(open), AbiToken::Uint(delay.into())];
        let code = constructor.encode_input(self.creation.clone(), &arguments);
        code.map_err(|error| ChainError::Internal(format!("constructor: {error}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_told_before_anything_is_sent() {
        let grant = |expiry, scope, length| Call::AuthorityGrant {
            grantee: Address([1; 20]),
            epoch: 1,
            expiry,
            scope,
            envelope: vec![1; length],
        };
        assert!(grant(None, Scope::All, 1).encode().is_ok());
        assert!(
            grant(Some(Timestamp::from_seconds(9)), Scope::Topics(vec![TopicId([1; 16]); 32]), 4096).encode().is_ok()
        );
        for bad in [
            grant(Some(Timestamp(1_500_000_000)), Scope::All, 1),
            grant(Some(Timestamp(0)), Scope::All, 1),
            grant(None, Scope::Topics(Vec::new()), 1),
            grant(None, Scope::Topics(vec![TopicId([1; 16]); 33]), 1),
            grant(None, Scope::All, 0),
            grant(None, Scope::All, 4097),
            Call::Rotate { new_token: Token([1; 32]), envelope: vec![1; 4097] },
            Call::Wrap { epoch: 1, envelopes: Vec::new() },
            Call::Wrap { epoch: 1, envelopes: vec![(Address([1; 20]), vec![1]); 33] },
        ] {
            assert!(matches!(bad.encode(), Err(ChainError::Input(_))), "{bad:?}");
        }
    }
}

#[cfg(test)]
mod artefact_tests {
    use super::*;
    use std::path::Path;
    use std::process::Command;

    #[test]
    fn the_artefact_is_for_old_evms_and_small_enough() {
        let file: serde_json::Value = serde_json::from_str(ARTEFACT).expect("JSON");
        assert!(file["compiler"].as_str().expect("compiler").starts_with("0.7.6"));
        assert!(artefact().expect("artefact").creation.len() < 24_576);
    }

    #[test]
    fn artefact_recompiles() {
        let Some(solc) = std::env::var_os("AUTHROS_SOLC") else {
            println!("SKIPPED artefact_recompiles: AUTHROS_SOLC names no folder of the npm module solc 0.7.6");
            return;
        };
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../contracts/compile.mjs");
        let output = Command::new("node").arg(script).arg("--check").arg(solc).output().expect("node runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}
