//! The contract once more, in plain Rust, for the differential tests: written from DESIGN section 6 and the
//! NatSpec of AuthROS.sol, with maps where that has mappings. It takes and gives ABI values, so that every
//! argument, event field and read can be compared; what it refuses it leaves as it was.

mod reads;
mod values;

use std::collections::{BTreeMap, BTreeSet};

use ethers::abi::Token as AbiToken;
use ethers::utils::keccak256;

use self::values::Values;
use crate::chain::call::{address, word};
use crate::model::Address;

type Word = [u8; 32];

/// Why a call is refused: the contract's reason code.
pub type Reason = &'static str;
type Done = Result<Vec<Emitted>, Reason>;

const ZERO: Word = [0; 32];
const NOBODY: Address = Address([0; 20]);
const IDENTITY_LENGTH: usize = 224;
const MOST_TOPICS: usize = 32;
const MOST_WRAPS: usize = 32;
const LONGEST_ENVELOPE: usize = 4096;
const LONGEST_TIMESTAMP: usize = 32;

/// An event: its name and all its fields, in the contract's order.
#[derive(Debug, Clone, PartialEq)]
pub struct Emitted(pub &'static str, pub Vec<AbiToken>);

/// Who calls, and where on the chain.
#[derive(Debug, Clone, Copy)]
pub struct Caller {
    /// The sender.
    pub sender: Address,
    /// The block's number.
    pub block: u64,
    /// The block's time, seconds.
    pub now: u64,
}

#[derive(Debug, Clone, Default)]
struct Account {
    epoch: u64,
    count: u64,
    keys: u64,
    suspended: bool,
    token: Word,
    last: Word,
    identity: Vec<u8>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Grant {
    active: bool,
    epoch: u64,
    expiry: u64,
    revokes: u64,
    scope: Word,
}

impl Grant {
    fn is_standing(self, now: u64) -> bool {
        self.active && (self.expiry == 0 || now < self.expiry)
    }
}

/// All that the contract keeps.
#[derive(Debug, Clone)]
pub struct Model {
    /// Who administers.
    pub administrator: Address,
    /// Who was named to.
    pub nominee: Address,
    open: bool,
    /// Whether changes are stopped.
    pub paused: bool,
    admitted: BTreeSet<Address>,
    successors: BTreeMap<Address, Address>,
    accounts: BTreeMap<Address, Account>,
    epochs: BTreeMap<(Address, Word), u64>,
    uploads: BTreeMap<(Address, Word), u64>,
    grants: BTreeMap<(Address, Address), Grant>,
    /// (owner, grantee, epoch) to (revokes, keys).
    envelopes: BTreeMap<(Address, Address, u64), (u64, u64)>,
    heads: BTreeMap<Address, Word>,
    /// (account, root) to (block, count).
    anchors: BTreeMap<(Address, Word), (u64, u64)>,
    /// (owner, device) to (active, until).
    loans: BTreeMap<(Address, Word), (bool, u64)>,
}

fn require(holds: bool, reason: Reason) -> Result<(), Reason> {
    if holds { Ok(()) } else { Err(reason) }
}

fn number(value: u64) -> AbiToken {
    AbiToken::Uint(value.into())
}

#[allow(clippy::unnecessary_wraps, reason = "the last word of a step, beside those that fail")]
fn one(name: &'static str, fields: Vec<AbiToken>) -> Done {
    Ok(vec![Emitted(name, fields)])
}

/// Exactly 32 bytes.
fn exact(bytes: &[u8]) -> Result<Word, Reason> {
    bytes.try_into().map_err(|_| "length")
}

fn token_of(identity: &[u8]) -> Result<Word, Reason> {
    require(identity.len() == IDENTITY_LENGTH, "length")?;
    exact(&identity[..32])
}

/// Zero for all topics, else the hash over the ids, each padded to a word as Solidity packs arrays.
fn scope_hash(topics: &[Vec<u8>]) -> Word {
    let padded: Vec<u8> = topics.iter().flat_map(|id| [&id[..], &[0; 16]].concat()).collect();
    if topics.is_empty() { ZERO } else { keccak256(padded) }
}

impl Model {
    /// As the constructor leaves it.
    pub fn new(administrator: Address, open: bool) -> Self {
        Self {
            administrator,
            nominee: NOBODY,
            open,
            paused: false,
            admitted: BTreeSet::new(),
            successors: BTreeMap::new(),
            accounts: BTreeMap::new(),
            epochs: BTreeMap::new(),
            uploads: BTreeMap::new(),
            grants: BTreeMap::new(),
            envelopes: BTreeMap::new(),
            heads: BTreeMap::new(),
            anchors: BTreeMap::new(),
            loans: BTreeMap::new(),
        }
    }

    /// A call by name.
    ///
    /// # Errors
    /// The reason code; nothing has changed.
    pub fn call(&mut self, caller: Caller, name: &str, arguments: &[AbiToken]) -> Done {
        let before = self.clone();
        let done = self.dispatch(caller, name, &Values(arguments));
        if done.is_err() {
            *self = before;
        }
        done
    }

    fn dispatch(&mut self, by: Caller, name: &str, values: &Values<'_>) -> Done {
        match name {
            "register" => self.register(by, values.bytes(0)),
            "rotateKeys" => self.rotate_keys(by, values.bytes(0)),
            "rotate" => self.rotate(by, values.word(0)),
            "dataUpload" => self.data_upload(by, &values.bytes(0), &values.bytes(1), values.bytes(2)),
            "anchor" => self.anchor(by, values.word(0), values.number(1), values.word(2)),
            "authorityGrant" => self.authority_grant(
                by,
                values.address(0),
                (values.number(1), values.number(2)),
                &values.list(3),
                values.bytes(4),
            ),
            "wrap" => self.wrap(by, &values.addresses(0), values.number(1), &values.list(2)),
            "authorityRevoke" => self.authority_revoke(by, values.address(0), values.word(1)),
            "lend" => self.lend(by, values.word(0), values.number(1)),
            "recall" => self.recall(by, values.word(0)),
            "acceptAdministrator" => self.accept_administrator(by),
            _ => {
                require(by.sender == self.administrator, "administrator")?;
                self.administer(name, values)
            }
        }
    }

    fn account(&self, who: Address) -> Account {
        self.accounts.get(&who).cloned().unwrap_or_default()
    }

    fn account_mut(&mut self, who: Address) -> &mut Account {
        self.accounts.entry(who).or_default()
    }

    fn grant(&self, owner: Address, grantee: Address) -> Grant {
        self.grants.get(&(owner, grantee)).copied().unwrap_or_default()
    }

    fn registered(&self, who: Address) -> Result<(), Reason> {
        require(self.account(who).epoch != 0, "unregistered")
    }

    fn acting(&self, who: Address) -> Result<(), Reason> {
        require(!self.paused, "paused")?;
        self.registered(who)?;
        require(!self.account(who).suspended, "suspended")
    }

    /// Begins the next epoch of an account with a token it never used.
    fn begin_epoch(&mut self, who: Address, token: Word) -> Result<u64, Reason> {
        require(token != ZERO, "empty")?;
        require(!self.epochs.contains_key(&(who, token)), "token used")?;
        let account = self.account_mut(who);
        account.epoch += 1;
        account.token = token;
        let epoch = account.epoch;
        self.epochs.insert((who, token), epoch);
        Ok(epoch)
    }

    fn register(&mut self, by: Caller, identity: Vec<u8>) -> Done {
        let account = self.account(by.sender);
        require(!self.paused, "paused")?;
        require(!account.suspended, "suspended")?;
        require(account.epoch == 0, "registered")?;
        require(self.open || self.admitted.contains(&by.sender), "closed")?;
        let token = token_of(&identity)?;
        self.begin_epoch(by.sender, token)?;
        let account = self.account_mut(by.sender);
        account.keys = 1;
        account.identity.clone_from(&identity);
        one("Registered", vec![address(by.sender), word(token), AbiToken::Bytes(identity)])
    }

    fn rotate_keys(&mut self, by: Caller, identity: Vec<u8>) -> Done {
        self.acting(by.sender)?;
        let token = token_of(&identity)?;
        let account = self.account_mut(by.sender);
        require(token == account.token, "token unknown")?;
        account.keys += 1;
        account.identity.clone_from(&identity);
        one("KeysRotated", vec![address(by.sender), number(account.keys), AbiToken::Bytes(identity)])
    }

    fn rotate(&mut self, by: Caller, token: Word) -> Done {
        self.registered(by.sender)?;
        let epoch = self.begin_epoch(by.sender, token)?;
        one("Rotated", vec![address(by.sender), number(epoch), word(token)])
    }

    fn data_upload(&mut self, by: Caller, digest: &[u8], token: &[u8], timestamp: Vec<u8>) -> Done {
        self.acting(by.sender)?;
        require(timestamp.len() <= LONGEST_TIMESTAMP, "length")?;
        let (digest, token) = (exact(digest)?, exact(token)?);
        let epoch = *self.epochs.get(&(by.sender, token)).ok_or("token unknown")?;
        require(!self.uploads.contains_key(&(by.sender, digest)), "digest used")?;
        self.uploads.insert((by.sender, digest), by.block);
        let account = self.account_mut(by.sender);
        account.count += 1;
        account.last = digest;
        let numbers = [number(epoch), number(account.count)];
        let fields = [address(by.sender), word(digest), word(token)].into_iter().chain(numbers);
        one("DataUploaded", fields.chain([AbiToken::Bytes(timestamp)]).collect())
    }

    fn anchor(&mut self, by: Caller, root: Word, count: u64, previous: Word) -> Done {
        self.acting(by.sender)?;
        require(root != ZERO && count != 0, "empty")?;
        require(self.heads.get(&by.sender).copied().unwrap_or(ZERO) == previous, "previous")?;
        self.heads.insert(by.sender, root);
        self.anchors.entry((by.sender, root)).or_insert((by.block, count));
        one("Anchored", vec![address(by.sender), word(root), number(count), word(previous)])
    }

    fn authority_grant(
        &mut self,
        by: Caller,
        grantee: Address,
        (epoch, expiry): (u64, u64),
        topics: &[Vec<u8>],
        envelope: Vec<u8>,
    ) -> Done {
        self.acting(by.sender)?;
        require(grantee != by.sender, "self")?;
        require(expiry == 0 || expiry > by.now, "expired")?;
        require(topics.len() <= MOST_TOPICS, "scope")?;
        self.give_envelope(by.sender, grantee, epoch, &envelope)?;
        let revokes = self.grant(by.sender, grantee).revokes;
        let grant = Grant { active: true, epoch, expiry, revokes, scope: scope_hash(topics) };
        self.grants.insert((by.sender, grantee), grant);
        let scope = AbiToken::Array(topics.iter().map(|id| AbiToken::FixedBytes(id.clone())).collect());
        let parties = [address(by.sender), address(grantee), number(epoch), number(expiry)];
        one("Granted", parties.into_iter().chain([scope, AbiToken::Bytes(envelope)]).collect())
    }

    fn wrap(&mut self, by: Caller, grantees: &[Address], epoch: u64, envelopes: &[Vec<u8>]) -> Done {
        self.acting(by.sender)?;
        require(grantees.len() <= MOST_WRAPS && grantees.len() == envelopes.len(), "length")?;
        let mut emitted = Vec::new();
        for (grantee, envelope) in grantees.iter().zip(envelopes) {
            require(self.grant(by.sender, *grantee).is_standing(by.now), "no grant")?;
            self.give_envelope(by.sender, *grantee, epoch, envelope)?;
            let fields = vec![address(by.sender), address(*grantee), number(epoch), AbiToken::Bytes(envelope.clone())];
            emitted.push(Emitted("Wrapped", fields));
        }
        Ok(emitted)
    }

    /// One envelope per (owner, grantee, epoch), one more after a revoke or for new keys of the grantee.
    fn give_envelope(&mut self, owner: Address, to: Address, epoch: u64, envelope: &[u8]) -> Result<(), Reason> {
        let keys = self.account(to).keys;
        require(keys != 0, "grantee")?;
        require((1..=self.account(owner).epoch).contains(&epoch), "epoch")?;
        require((1..=LONGEST_ENVELOPE).contains(&envelope.len()), "envelope")?;
        let revokes = self.grant(owner, to).revokes;
        let given = self.envelopes.get(&(owner, to, epoch)).copied().unwrap_or_default();
        require(given.0 < revokes || given.1 < keys, "wrapped")?;
        self.envelopes.insert((owner, to, epoch), (revokes, keys));
        Ok(())
    }

    fn authority_revoke(&mut self, by: Caller, grantee: Address, token: Word) -> Done {
        self.registered(by.sender)?;
        require(self.grant(by.sender, grantee).active, "no grant")?;
        let epoch = self.begin_epoch(by.sender, token)?;
        let grant = self.grants.entry((by.sender, grantee)).or_default();
        grant.active = false;
        grant.revokes += 1;
        one("Revoked", vec![address(by.sender), address(grantee), number(epoch), word(token)])
    }

    fn lend(&mut self, by: Caller, device: Word, until: u64) -> Done {
        self.acting(by.sender)?;
        require(device != ZERO, "empty")?;
        require(until == 0 || until > by.now, "expired")?;
        self.loans.insert((by.sender, device), (true, until));
        one("Lent", vec![address(by.sender), word(device), number(until)])
    }

    fn recall(&mut self, by: Caller, device: Word) -> Done {
        self.registered(by.sender)?;
        let loan = self.loans.get_mut(&(by.sender, device)).filter(|loan| loan.0).ok_or("no loan")?;
        loan.0 = false;
        one("Recalled", vec![address(by.sender), word(device)])
    }

    fn accept_administrator(&mut self, by: Caller) -> Done {
        require(by.sender == self.nominee, "nominee")?;
        let previous = self.administrator;
        self.administrator = by.sender;
        self.nominee = NOBODY;
        one("AdministratorChanged", vec![address(previous), address(by.sender)])
    }

    fn administer(&mut self, name: &str, values: &Values<'_>) -> Done {
        match name {
            "admit" => {
                require(self.admitted.insert(values.address(0)), "unchanged")?;
                one("Admitted", vec![address(values.address(0))])
            }
            "setOpen" => {
                require(self.open != values.flag(0), "unchanged")?;
                self.open = values.flag(0);
                one("OpenChanged", vec![AbiToken::Bool(self.open)])
            }
            "setPaused" => {
                require(self.paused != values.flag(0), "unchanged")?;
                self.paused = values.flag(0);
                one("PausedChanged", vec![AbiToken::Bool(self.paused)])
            }
            "suspend" => self.suspend(values.address(0)),
            "restore" => self.restore(values.address(0)),
            "succeed" => self.succeed(values.address(0), values.address(1)),
            "nominate" => {
                self.nominee = values.address(0);
                one("AdministratorNominated", vec![address(self.nominee)])
            }
            other => panic!("the model knows no {other}"),
        }
    }

    fn suspend(&mut self, who: Address) -> Done {
        require(!self.account(who).suspended, "unchanged")?;
        self.account_mut(who).suspended = true;
        one("Suspended", vec![address(who)])
    }

    fn restore(&mut self, who: Address) -> Done {
        require(self.account(who).suspended, "unchanged")?;
        require(!self.successors.contains_key(&who), "succeeded")?;
        self.account_mut(who).suspended = false;
        one("Restored", vec![address(who)])
    }

    fn succeed(&mut self, lost: Address, successor: Address) -> Done {
        self.registered(lost)?;
        self.registered(successor)?;
        require(lost != successor, "self")?;
        require(!self.account(successor).suspended, "successor")?;
        self.successors.insert(lost, successor);
        self.account_mut(lost).suspended = true;
        one("Succeeded", vec![address(lost), address(successor)])
    }

    /// The token of an account's current epoch; zero where it is not registered.
    pub fn token(&self, who: Address) -> Word {
        self.account(who).token
    }

    /// An account's epoch; 0 where it is not registered.
    pub fn epoch(&self, who: Address) -> u64 {
        self.account(who).epoch
    }

    /// Who holds a grant of an owner that was not revoked.
    pub fn holders(&self, owner: Address) -> Vec<Address> {
        let held = self.grants.iter().filter(|((from, _), grant)| *from == owner && grant.active);
        held.map(|((_, to), _)| *to).collect()
    }

    /// The first byte of a device that an owner lends.
    pub fn lent(&self, owner: Address) -> Option<u8> {
        self.loans.iter().find(|((from, _), loan)| *from == owner && loan.0).map(|((_, device), _)| device[0])
    }

    /// The root that an account anchored last.
    pub fn head(&self, who: Address) -> Word {
        self.heads.get(&who).copied().unwrap_or(ZERO)
    }
}
