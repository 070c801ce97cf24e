//! What can go wrong with a chain, and plain words for a contract's reason codes.

use std::path::PathBuf;

use serde_json::Value;

use super::{Shortfall, transport::JsonRpcError};
use crate::model::{Address, Consensus, ErrorKind, Wei, bytes::unhex, clean, counted};

/// Advice where the pinned chain does not come back.
pub const SEAL_ANEW: &str = "`authros --home NEW records import OLD` (seals all messages in a new home)";

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ChainError {
    /// `url` has neither credentials nor path; `reason` is a predicate of the node.
    #[error("the node at {url} {reason}; {advice}")]
    Unreachable { url: String, reason: String, advice: String },
    #[error("{url} gave an unexpected answer to {method} ({reason}); check that `chain.url` is an Ethereum node")]
    Answer { url: String, method: String, reason: String },
    #[error("'{0}' is not the address of a node; use http://HOST:PORT, https:// or ipc:/PATH")]
    Url(String),
    #[error("{0}; check `chain.roots`")]
    Roots(String),
    #[error(
        "start the pinned chain, or {SEAL_ANEW}: the chain at {url} is another one, its {what} is {}, not {}; anchoring is \
         paused, records are safe",
        clean(found, 24),
        clean(pinned, 24)
    )]
    Swapped { url: String, what: &'static str, pinned: String, found: String },
    #[error(
        "give --chain or --site if this home uses another chain than its own, restore the chain's file, or {SEAL_ANEW}: \
         the embedded chain {} is gone, or never was; anchoring is paused, records are safe",
        path.display()
    )]
    Gone { path: PathBuf },
    #[error("the chain cannot be queried: {why}")]
    Absent { why: String },
    #[error("no contract is set for this chain; deploy one with `authros chain deploy`, or set `chain.contract`")]
    NoContract,
    #[error(
        "the code at {0} is not AuthROS's contract of version 1; check the address, use a newer authros for a later \
         contract, or deploy a new one"
    )]
    NotTheContract(Address),
    #[error("the contract refused: {}", explain(.code))]
    Reverted { code: String },
    #[error("the node already has this transaction; wait for its receipt")]
    AlreadyKnown,
    #[error("the transaction's nonce is already used; look for its receipt, or sign it again with the next nonce")]
    NonceTooLow,
    #[error("the node rejects the gas price as too low; sign the transaction again with the current gas price")]
    Underpriced,
    #[error("the account has too little ether for the transaction; send it some, or use a network without fees")]
    InsufficientFunds,
    #[error("{0}, then repeat the command")]
    NoEther(Shortfall),
    #[error("the network requires {needed} per gas, more than chain.max_fee = {cap} allows; wait or raise it")]
    TooDear { needed: Wei, cap: Wei },
    #[error(
        "the transaction needs up to {needed} gas, but the node reports that a block holds at most {limit}; raise the \
         network's block gas limit, or correct `chain.url`"
    )]
    BlockTooSmall { needed: u64, limit: u64 },
    #[error("the node refused {method}: {reason}")]
    Rejected { method: String, reason: String },
    /// `blocks` passed it by; `price` is its last offer.
    #[error("the transaction was sent but not mined within {seconds} s: {}", passed_by(*.blocks, *.price))]
    NotMined { seconds: u64, blocks: u64, price: Wei },
    #[error("{0}")]
    Input(String),
    #[error(
        "restore the chain's file from a backup, or move it away and run {SEAL_ANEW}: the embedded chain {} was changed or \
         damaged at block {block}: {what}", path.display()
    )]
    Tampered { path: PathBuf, block: u64, what: String },
    #[error("the embedded chain {} cannot be used: {reason}; check the directory's permissions and free \
             space", path.display())]
    File { path: PathBuf, reason: String },
    #[error("the embedded chain {} has version {found}, but this program supports only {known}; use a newer \
             authros", path.display())]
    Newer { path: PathBuf, found: i64, known: i64 },
    #[error(
        "the embedded chain {} was created with {founded}, but {asked} was requested; leave `chain.consensus` empty, \
         or use another --home", path.display()
    )]
    OtherConsensus { path: PathBuf, founded: Consensus, asked: Consensus },
    #[error("internal error in the chain code: {0}; please report it")]
    Internal(String),
}

impl ChainError {
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Unreachable { .. } | Self::Absent { .. } | Self::Answer { .. } | Self::NotMined { .. } => {
                ErrorKind::Unreachable
            }
            Self::Url(_)
            | Self::Roots(_)
            | Self::NoContract
            | Self::OtherConsensus { .. }
            | Self::Newer { .. }
            | Self::Input(_) => ErrorKind::Input,
            Self::Tampered { .. } => ErrorKind::Tampered,
            Self::File { .. } => ErrorKind::Home,
            Self::Internal(_) => ErrorKind::Internal,
            Self::Swapped { .. }
            | Self::Gone { .. }
            | Self::NotTheContract(_)
            | Self::Reverted { .. }
            | Self::AlreadyKnown
            | Self::NonceTooLow
            | Self::Underpriced
            | Self::InsufficientFunds
            | Self::NoEther(_)
            | Self::TooDear { .. }
            | Self::BlockTooSmall { .. }
            | Self::Rejected { .. } => ErrorKind::Refused,
        }
    }

    /// Judges by words, because nodes do not agree on codes.
    pub(super) fn from_node(method: &str, error: &JsonRpcError) -> Self {
        if let Some(code) = revert_code(error) {
            return Self::Reverted { code };
        }
        let lower = error.message.to_lowercase();
        let says = |words: &[&str]| words.iter().any(|word| lower.contains(word));
        let is_poor = says(&[
            "insufficient funds",
            "insufficientfunds",
            "insufficient balance",
            "enough funds",
            "exceeds account balance",
            "upfront cost exceeds",
        ]);
        if says(&["already known", "known transaction", "already imported", "alreadyknown"]) {
            Self::AlreadyKnown
        } else if says(&["nonce too low", "nonce is too low", "correct nonce", "oldnonce"]) {
            Self::NonceTooLow
        } else if is_poor {
            Self::InsufficientFunds
        } else if says(&["underpriced", "gas price", "fee too low", "base fee", "basefee"]) {
            Self::Underpriced
        } else {
            Self::Rejected { method: method.to_owned(), reason: clean(&error.message, 200) }
        }
    }
}

pub fn passed_by(blocks: u64, price: Wei) -> String {
    match blocks {
        0 => "the network produces no blocks; check its signers or miners".to_owned(),
        1 => format!("not included in 1 block at {price} per gas; wait for the next blocks"),
        _ => format!(
            "not included in {} at {price} per gas; ask the network's operators for the lowest price they \
             accept, then set chain.min_price or raise chain.max_fee",
            counted(blocks, "block")
        ),
    }
}

fn revert_code(error: &JsonRpcError) -> Option<String> {
    // Ganache says "revert", others "reverted".
    if !error.message.contains("revert") {
        return None;
    }
    let data = error.data.as_ref().and_then(first_hex).unwrap_or_default();
    if let Some(code) = decode_revert(&data) {
        return Some(code);
    }
    let tail = error.message.rsplit_once("revert").map_or("", |(_, tail)| tail.trim_start_matches("ed"));
    Some(clean(tail.trim_start_matches([':', ' ']), 80))
}

/// Every node wraps revert data in objects of its own.
fn first_hex(value: &Value) -> Option<Vec<u8>> {
    match value {
        Value::String(text) => unhex(text),
        Value::Object(members) => members.values().find_map(first_hex),
        _ => None,
    }
}

/// The text of `Error(string)`.
pub(super) fn decode_revert(data: &[u8]) -> Option<String> {
    const ERROR: [u8; 4] = [0x08, 0xc3, 0x79, 0xa0];
    let arguments = data.strip_prefix(&ERROR)?;
    let tokens = ethers::abi::decode(&[ethers::abi::ParamType::String], arguments).ok()?;
    tokens.into_iter().next()?.into_string().map(|text| clean(&text, 80))
}

pub(super) fn decode_revert_hex(text: &str) -> Option<String> {
    decode_revert(&unhex(text)?)
}

pub fn explain(code: &str) -> String {
    let words = match code {
        "unregistered" => "the account is not registered on this contract; run `authros identity register` first",
        "grantee" => "the grantee is not registered on this contract; ask them to run `authros identity register`",
        "registered" => "the account is already registered; use `authros keys rotate` to change its keys",
        "suspended" => "the administrator suspended the account; ask the administrator",
        "paused" => "the administrator paused the contract; try again later",
        "closed" => "registration is closed; ask the administrator to allow the account",
        "successor" => "the successor is itself suspended or lost; name another account",
        "succeeded" => "the account has a successor and stays suspended; use the successor's account",
        "token unknown" => "the account never registered this token; check that the keyring belongs to this account",
        "token used" => "the token belongs to an earlier epoch; rotate again with a fresh key",
        "digest used" => "the account already anchored this digest; nothing to do",
        "previous" => "another root has been anchored since; read the head and sign again",
        "no grant" => "there is no grant in force for that account; see `authros grant list`",
        "shorter" => {
            "the grant already ends later than that, or never; `extend` only lengthens it, revoke it to end it sooner"
        }
        "pending" => "a succession of that account is already pending; see `authros chain succession list`",
        "no proposal" => "no succession of that account is pending; see `authros chain succession list`",
        "early" => "the succession is still pending; see `authros chain succession list` for its date",
        "recovery" => {
            "only the recovery account named when it was proposed, or the administrator, may stop a succession"
        }
        "pause" => "a pause must end in the future and last at most three days; give another end",
        "gap" => "changes were paused within the last week; the next pause must wait",
        "delay" => "the succession delay must be between a day and a year; deploy with another one",
        "no loan" => "the device is not authorised; nothing to do",
        "wrapped" => "the grantee already has the envelope of that epoch; rotate the epoch to change the grant",
        "epoch" => "that epoch has not started; grant the current one or an earlier one",
        "expired" => "the end is in the past; give a later one",
        "scope" => "the grant names too many topics; name at most 32, or all",
        "envelope" => "the envelope is empty or longer than 4096 bytes; grant fewer topics or epochs",
        "self" => "an account cannot do this to itself; name another account",
        "length" => "a value has the wrong length; this program and the contract do not match",
        "empty" => "a value is zero where that is not allowed; this program and the contract do not match",
        "administrator" => "only the administrator may do this; use the administrator's account",
        "nominee" => "only the nominated administrator may accept; ask to be nominated",
        "unchanged" => "this is already the case; nothing to do",
        "" => "it gave no reason; check that this is an AuthROS contract",
        other => return format!("{}; see the contract's source", clean(other, 80)),
    };
    words.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn answer(message: &str, data: Option<serde_json::Value>) -> ChainError {
        ChainError::from_node("eth_call", &JsonRpcError { code: -32000, message: message.into(), data })
    }

    #[test]
    fn reasons_are_found_however_a_node_wraps_them() {
        let text = ethers::abi::encode(&[ethers::abi::Token::String("grantee".into())]);
        let data = format!("0x08c379a0{}", crate::model::bytes::hex(&text));
        let expected = ChainError::Reverted { code: "grantee".into() };
        assert_eq!(answer("execution reverted", Some(json!(&data))), expected);
        assert_eq!(answer("execution reverted: grantee", None), expected);
        assert_eq!(answer("VM Exception while processing transaction: revert grantee", None), expected);
        assert_eq!(answer("VM Exception: revert", Some(json!({ "stack": "x", "result": data }))), expected);
        assert!(expected.to_string().contains("ask them to run `authros identity register`"));
    }

    #[test]
    fn refusals_of_several_nodes() {
        for (message, expected) in [
            ("already known", ChainError::AlreadyKnown),
            ("transaction already imported", ChainError::AlreadyKnown),
            ("nonce too low: next nonce 5, tx nonce 3", ChainError::NonceTooLow),
            ("the tx doesn't have the correct nonce. account has nonce of: 2", ChainError::NonceTooLow),
            ("replacement transaction underpriced", ChainError::Underpriced),
            ("max fee per gas less than block base fee", ChainError::Underpriced),
            ("insufficient funds for gas * price + value", ChainError::InsufficientFunds),
            ("Upfront cost exceeds account balance", ChainError::InsufficientFunds),
            ("InsufficientFunds, Account balance: 0, cumulative cost: 1", ChainError::InsufficientFunds),
            ("Gas price below configured minimum gas price", ChainError::Underpriced),
        ] {
            assert_eq!(answer(message, None), expected, "{message}");
        }
        let other = answer("boo\u{1b}[2J", None);
        assert!(!other.to_string().contains('\u{1b}'));
        assert_eq!(other.kind(), ErrorKind::Refused);
    }
}
