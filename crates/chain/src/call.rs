//! Calls of the contract and their encoding.

use ethers::abi::Token as AbiToken;
use ethers::types::{H160, U256};

use super::ChainError;
use super::artefact::artefact;
use crate::model::{Address, Digest, Hash, Identity, Scope, SignerId, Timestamp, Token, grant::MOST_TOPICS};

/// The most grantees in one [`Call::Wrap`] (contract limit).
pub const MOST_WRAPS: usize = 32;
/// The longest envelope, bytes (contract limit).
pub const LONGEST_ENVELOPE: usize = 4096;

/// A change of the contract's state, made by the sender of the transaction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Call {
    /// Registers the sender at epoch 1.
    Register {
        /// Token, keys and proof.
        identity: Identity,
        /// The epoch's key, wrapped for the sender; empty if it seals nothing.
        envelope: Vec<u8>,
    },
    /// Replaces the sender's SM2 keys; the epoch continues.
    RotateKeys {
        /// Current token, new keys and proof.
        identity: Identity,
        /// The new keys, wrapped for the keys that they replace.
        envelope: Vec<u8>,
    },
    /// Puts one digest on the chain.
    DataUpload {
        /// SM3 of the record.
        digest: Digest,
        /// Any token that the sender has ever registered.
        token: Token,
        /// When the record was captured.
        timestamp: Timestamp,
    },
    /// Lets a grantee read.
    AuthorityGrant {
        /// The grantee.
        grantee: Address,
        /// The epoch whose key the envelope carries.
        epoch: u64,
        /// When it ends, whole seconds; `None` = never.
        expiry: Option<Timestamp>,
        /// The topics.
        scope: Scope,
        /// The wrapped keys, at most [`LONGEST_ENVELOPE`].
        envelope: Vec<u8>,
    },
    /// Gives grantees the envelopes of another epoch.
    Wrap {
        /// The epoch.
        epoch: u64,
        /// Grantees and their envelopes, at most [`MOST_WRAPS`].
        envelopes: Vec<(Address, Vec<u8>)>,
    },
    /// Ends a grant and the epoch.
    AuthorityRevoke {
        /// The grantee.
        grantee: Address,
        /// Token of the next epoch.
        new_token: Token,
        /// Its key, wrapped for the sender.
        envelope: Vec<u8>,
    },
    /// Ends the epoch.
    Rotate {
        /// Token of the next epoch.
        new_token: Token,
        /// Its key, wrapped for the sender.
        envelope: Vec<u8>,
    },
    /// Anchors a Merkle root.
    Anchor {
        /// The root.
        root: Hash,
        /// Number of leaves.
        count: u64,
        /// The sender's last root, zero for the first.
        previous: Hash,
    },
    /// Lets a device sign for the sender.
    Lend {
        /// SM3 of its public key.
        device: SignerId,
        /// When it ends, whole seconds; `None` = never.
        until: Option<Timestamp>,
    },
    /// Ends a loan.
    Recall {
        /// SM3 of the device's public key.
        device: SignerId,
    },
    /// Administrator: lets an account register while registration is closed.
    Admit {
        /// The account.
        account: Address,
    },
    /// Administrator: withdraws an admission.
    Dismiss {
        /// The account.
        account: Address,
    },
    /// Administrator: opens or closes registration.
    SetOpen {
        /// Whether anyone may register.
        open: bool,
    },
    /// Administrator: suspends an account's changes.
    Suspend {
        /// The account.
        account: Address,
    },
    /// Administrator: lifts an account's suspension.
    Restore {
        /// The account.
        account: Address,
    },
    /// Administrator: pauses all changes except those that take rights away, until a given time.
    Pause {
        /// When they resume, whole seconds; at most [`super::LONGEST_PAUSE`] ahead.
        until: Timestamp,
    },
    /// Administrator: resumes changes before the pause ends.
    Resume,
    /// Administrator: proposes the successor of a lost account.
    ProposeSuccession {
        /// The account whose key is lost.
        lost: Address,
        /// The successor.
        successor: Address,
    },
    /// Recovery account or administrator: stops a pending succession.
    CancelSuccession {
        /// The lost account.
        lost: Address,
    },
    /// Anyone: completes a succession whose delay is over.
    CompleteSuccession {
        /// The lost account.
        lost: Address,
    },
    /// Names the account that may stop a succession of the sender's account.
    NameRecovery {
        /// The recovery account; `None` = nobody.
        recovery: Option<Address>,
    },
    /// Extends a grant.
    Extend {
        /// The grantee.
        grantee: Address,
        /// Its new end, whole seconds; `None` = never.
        expiry: Option<Timestamp>,
    },
    /// Administrator: nominates the next administrator.
    Nominate {
        /// The nominee; the zero address withdraws the nomination.
        account: Address,
    },
    /// The nominee takes over.
    AcceptAdministrator,
}

impl Call {
    /// The name of the contract's function.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Register { .. } => "register",
            Self::RotateKeys { .. } => "rotateKeys",
            Self::DataUpload { .. } => "dataUpload",
            Self::AuthorityGrant { .. } => "authorityGrant",
            Self::Wrap { .. } => "wrap",
            Self::AuthorityRevoke { .. } => "authorityRevoke",
            Self::Rotate { .. } => "rotate",
            Self::Anchor { .. } => "anchor",
            Self::Lend { .. } => "lend",
            Self::Recall { .. } => "recall",
            Self::Admit { .. } => "admit",
            Self::SetOpen { .. } => "setOpen",
            Self::Suspend { .. } => "suspend",
            Self::Restore { .. } => "restore",
            Self::Dismiss { .. } => "dismiss",
            Self::Pause { .. } => "pause",
            Self::Resume => "resume",
            Self::ProposeSuccession { .. } => "proposeSuccession",
            Self::CancelSuccession { .. } => "cancelSuccession",
            Self::CompleteSuccession { .. } => "completeSuccession",
            Self::NameRecovery { .. } => "nameRecovery",
            Self::Extend { .. } => "extend",
            Self::Nominate { .. } => "nominate",
            Self::AcceptAdministrator => "acceptAdministrator",
        }
    }

    /// The call data.
    ///
    /// # Errors
    /// [`ChainError::Input`] if a value breaks a limit of the contract.
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

/// Whole seconds, 0 for never. A fraction is refused: the chain would show a different end from the one signed.
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
        let advice = "grant fewer topics or epochs at once";
        return Err(ChainError::Input(format!("an envelope has 1 to {LONGEST_ENVELOPE} bytes, not {found}; {advice}")));
    }
    Ok(envelope.to_vec())
}

/// An owner's envelope for itself; accounts that seal nothing have none.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::TopicId;

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
