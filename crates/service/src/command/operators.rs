//! Commands about operators: people with keys of their own who work at a profile, under rights that its owner signed.

use serde::{Deserialize, Serialize};

use super::{Ask, Command};
use crate::model::{OperatorName, OperatorRights, PublicKey, Signature, Timestamp};
use crate::service::reply::{OperatorChallenge, OperatorView};

requests! {
    /// One of these.
    #[serde(rename_all = "snake_case", tag = "operator")]
    enum OperatorCommand by Command::OfOperator;
    /// Certify an operator's key; needs the keyring.
    AddOperator {
        /// Its name.
        name: OperatorName,
        /// Its public key.
        key: PublicKey,
        /// What it may do.
        rights: OperatorRights,
        /// Before when; `None` = until it is removed.
        #[serde(default)]
        until: Option<Timestamp>,
    } => Vec<OperatorView>;
    /// End an operator, also on the connections that it has.
    RemoveOperator {
        /// Its name.
        name: OperatorName,
    } => Vec<OperatorView>;
    /// The operators of the profile.
    ListOperators => Vec<OperatorView>;
    /// What is to be signed to act as an operator on this connection; once.
    ChallengeOperator => OperatorChallenge;
    /// From now on this connection acts as an operator of the profile, and as nobody else.
    ActAsOperator {
        /// Its name.
        name: OperatorName,
        /// Its signature over the challenge.
        proof: Signature,
    } => OperatorView;
}
