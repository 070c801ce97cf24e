//! Answers about profiles, their keys and transactions, and their readers.

use serde::{Deserialize, Serialize};

pub use crate::pipeline::GrantState;

use crate::command::SecretBytes;
use crate::model::{
    Address, Clock, ContactName, Hash, ProfileName, PublicKey, SignerId, Timestamp, Token, TopicName, clean, counted,
};

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IdentityView {
    pub profile: ProfileName,
    pub exists: bool,
    /// Its keyring is open in this site.
    pub unlocked: bool,
    /// On the chain in use.
    pub registered: bool,
    pub address: Option<Address>,
    /// Where its passphrase is stored, if it is; cleaned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub passphrase_file: Option<String>,
    pub epoch: Option<u64>,
    /// What a grant of that epoch opens already.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub epoch_records: Option<Opens>,
    /// The same of all epochs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub all_records: Option<Opens>,
    pub signing_key: Option<PublicKey>,
    pub fingerprint: Option<String>,
    pub envelope_key: Option<PublicKey>,
}

/// The messages that a grant opens, as far as this home knows them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Opens {
    pub records: u64,
    /// Capture of the first; `None` = there is none yet.
    pub since: Option<Timestamp>,
    /// Robots may have more that has not arrived here.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub of_robots: bool,
}

impl Opens {
    /// `since 21:50:41 UTC, 8,505 records`, with the moment as the reader writes it.
    pub fn words(self, moment: impl Fn(Timestamp) -> String) -> String {
        let known = match self.since {
            Some(since) => format!("since {}, {}", moment(since), counted(self.records, "record")),
            None => "no record yet".to_owned(),
        };
        if self.of_robots { known + ", as far as they have arrived here" } else { known }
    }
}

pub const NOTHING_OLDER: &str = "from now on, nothing older";

/// What a grant would do.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GrantForesight {
    /// The first epoch that it opens.
    pub epoch: u64,
    /// What it covers; empty = all topics.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub topics: Vec<TopicName>,
    /// How many begin with it: one for "from now on", and one if a standing grant is revoked before.
    pub epochs: usize,
    /// Nobody can have sealed anything under the keys that it gives.
    pub nothing_older: bool,
    pub opens: Opens,
    /// Readers who get the key of the new epoch.
    pub readers: usize,
    /// Robots that are told of it; until then this reader opens nothing that they seal.
    pub robots: Vec<ProfileName>,
    pub transactions: usize,
}

impl GrantForesight {
    /// `from now on, nothing older` or `since …, 8,505 records`.
    pub fn moment(&self, moment: impl Fn(Timestamp) -> String) -> String {
        if self.nothing_older { NOTHING_OLDER.to_owned() } else { self.opens.words(moment) }
    }

    /// `a new epoch: 2 other readers get the key, no robot is told; 3 transactions`.
    pub fn cost(&self) -> String {
        let transactions = counted(self.transactions as u64, "transaction");
        let epochs = match self.epochs {
            0 => return transactions,
            1 => "a new epoch".to_owned(),
            several => counted(several as u64, "new epoch"),
        };
        let readers = counted(self.readers as u64, "other reader");
        let get = if self.readers == 1 { "gets" } else { "get" };
        let names: Vec<&str> = self.robots.iter().map(ProfileName::as_str).collect();
        let robots = match names.as_slice() {
            [] => "no robot is told".to_owned(),
            [one] => format!("the robot {one} is told; until it hears, this reader opens nothing that it seals"),
            many => format!(
                "{} are told ({}); until one hears, this reader opens nothing that it seals",
                counted(many.len() as u64, "robot"),
                clean(&many.join(", "), 60)
            ),
        };
        format!("{epochs}: {readers} {get} the key, {robots}; {transactions}")
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpochView {
    pub epoch: u64,
    pub token: Token,
    pub current: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeysView {
    pub address: Address,
    pub signing_key: PublicKey,
    pub signing_fingerprint: String,
    pub envelope_key: PublicKey,
    pub envelope_fingerprint: String,
    pub epochs: Vec<EpochView>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyChangeView {
    pub readers: Vec<Address>,
    pub sharers: Vec<Address>,
    pub robots: Vec<ProfileName>,
    pub keeps_gateway: bool,
    pub joined: Option<String>,
    /// The effects, in words.
    pub lines: Vec<String>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct EnrolledView {
    /// N, its name at the gateway.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    pub gateway: RobotGatewayView,
    pub file: SecretBytes,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotGatewayView {
    /// Host:port, in the order in which the robot tries them; cleaned.
    pub addresses: Vec<String>,
    /// SM3 of its identity key.
    pub key: SignerId,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceAddressesView {
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    pub gateway: RobotGatewayView,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceTopicsView {
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    pub added: Vec<String>,
    pub topics: Vec<String>,
}

/// Result of a transaction of the profile.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransactionView {
    /// `None` = nothing had to be sent.
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    pub epoch: u64,
    pub text: String,
    /// Times that the text names, in UTC.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub times: Vec<Timestamp>,
}

impl TransactionView {
    pub fn mined(transaction: Hash, block: u64, epoch: u64, text: String) -> Self {
        Self { transaction: Some(transaction), block: Some(block), epoch, text, times: Vec::new() }
    }

    /// The text with the reader's time before each time in UTC.
    pub fn words(&self, clock: &Clock) -> String {
        clock.explained(&self.text, &self.times)
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContactRow {
    pub name: ContactName,
    pub address: Address,
    /// As noted.
    pub fingerprint: Option<String>,
    /// Noted by a person, not by the chain.
    pub given: bool,
    /// Fingerprint of the registered key.
    pub registered: Option<String>,
    /// `same`, `differs`, `not registered` or `not noted`.
    pub state: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompareView {
    pub account: Address,
    pub name: Option<String>,
    pub fingerprint: String,
    /// In the same form.
    pub given: String,
    pub equal: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SuccessionView {
    pub lost: Address,
    pub lost_name: Option<String>,
    pub successor: Address,
    pub successor_name: Option<String>,
    pub block: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProposalView {
    pub lost: Address,
    pub lost_name: Option<String>,
    pub successor: Address,
    pub successor_name: Option<String>,
    /// Who may stop it, besides the administrator.
    pub recovery: Option<Address>,
    /// When it can be completed.
    pub due: Timestamp,
    pub block: u64,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecoveryView {
    pub account: Option<Address>,
    /// Named last, not in effect yet.
    pub next: Option<Address>,
    pub from: Option<Timestamp>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdministrationView {
    pub administrator: Option<Address>,
    pub nominee: Option<Address>,
    pub open: bool,
    /// All changes are blocked now except those that take rights away.
    pub paused: bool,
    /// `None` = no pause.
    pub paused_until: Option<Timestamp>,
    /// Delay of a succession, seconds.
    pub delay: u64,
    pub proposals: Vec<ProposalView>,
    /// Who may stop a succession of the profile's account.
    pub recovery: RecoveryView,
    pub suspended: Vec<Address>,
    pub successions: Vec<SuccessionView>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    Given,
    Received,
}

crate::model::words!(Direction);

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GrantRow {
    pub direction: Direction,
    pub owner: Address,
    pub grantee: Address,
    /// In which it was given.
    pub epoch: u64,
    /// The first epoch that it opens; `None` = not known here.
    pub from: Option<u64>,
    /// What it opens now; `None` = not known here, or it has ended.
    pub opens: Option<Opens>,
    pub expires: Option<Timestamp>,
    /// Names if known, otherwise ids; empty = all topics.
    pub topics: Vec<String>,
    pub state: GrantState,
    pub block: u64,
    pub transaction: Hash,
    pub name: Option<String>,
    /// Of the other side's registered SM2 key.
    pub fingerprint: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceRow {
    pub device: SignerId,
    /// As the device shows it.
    pub fingerprint: String,
    /// `authorised`, `expired` or `revoked`.
    pub state: String,
    pub from: u64,
    pub until: Option<Timestamp>,
    pub recalled: Option<u64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_grant_opens_and_costs_in_words() {
        let since = Some(Timestamp::from_seconds(1_700_000_000));
        let opens = |records, since| Opens { records, since, of_robots: false }.words(Timestamp::in_utc);
        assert_eq!(opens(8_505, since), "since 2023-11-14 22:13:20 UTC, 8,505 records");
        assert_eq!(opens(1, since), "since 2023-11-14 22:13:20 UTC, 1 record");
        assert_eq!(opens(1_234_567, since), "since 2023-11-14 22:13:20 UTC, 1,234,567 records");
        assert_eq!(opens(0, None), "no record yet");
        let arrived = Opens { records: 2, since, of_robots: true }.words(Timestamp::in_utc);
        assert_eq!(arrived, "since 2023-11-14 22:13:20 UTC, 2 records, as far as they have arrived here");
        let now =
            GrantForesight { epoch: 2, epochs: 1, nothing_older: true, transactions: 2, ..GrantForesight::default() };
        assert_eq!(now.moment(Timestamp::in_utc), "from now on, nothing older");
        assert_eq!(now.cost(), "a new epoch: 0 other readers get the key, no robot is told; 2 transactions");
        let robots = ["scout-1", "scout-2"].map(|name| name.parse().expect("a name")).to_vec();
        let more = GrantForesight { epochs: 2, readers: 1, robots, transactions: 5, ..now };
        let told = "2 robots are told (scout-1, scout-2); until one hears, this reader opens nothing that it seals";
        assert_eq!(more.cost(), format!("2 new epochs: 1 other reader gets the key, {told}; 5 transactions"));
        let past = GrantForesight {
            opens: Opens { records: 2, since, of_robots: false },
            transactions: 1,
            ..GrantForesight::default()
        };
        assert_eq!(
            (past.moment(Timestamp::in_utc).as_str(), past.cost().as_str()),
            ("since 2023-11-14 22:13:20 UTC, 2 records", "1 transaction")
        );
    }
}
