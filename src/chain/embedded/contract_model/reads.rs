//! The reads of the model: every public view of the contract.

use std::collections::BTreeMap;

use ethers::abi::Token as AbiToken;

use super::values::Values;
use super::{Account, Caller, Model, NOBODY, Reason, Word, ZERO, exact, number};
use crate::chain::call::{address, word};
use crate::model::Address;

impl Model {
    /// Whether `reader` may read `owner`'s records of `epoch`.
    fn may_read(&self, owner: Address, reader: Address, epoch: u64, now: u64) -> bool {
        let grant = self.grant(owner, reader);
        let given = self.envelopes.get(&(owner, reader, epoch));
        let covered = epoch >= grant.epoch || given.is_some_and(|given| given.0 == grant.revokes);
        reader == owner || (grant.is_standing(now) && !self.account(reader).suspended && covered)
    }

    /// A read by name.
    ///
    /// # Errors
    /// The reason code.
    pub fn read(&self, by: Caller, name: &str, arguments: &[AbiToken]) -> Result<Vec<AbiToken>, Reason> {
        let values = Values(arguments);
        let owner = || values.address(0);
        let known = |map: &BTreeMap<(Address, Word), u64>| map.get(&(owner(), values.word(1))).copied().unwrap_or(0);
        Ok(match name {
            "administrator" => vec![address(self.administrator)],
            "nominee" => vec![address(self.nominee)],
            "open" => vec![AbiToken::Bool(self.open)],
            "paused" => vec![AbiToken::Bool(self.paused)],
            "admitted" => vec![AbiToken::Bool(self.admitted.contains(&owner()))],
            "successorOf" => vec![address(self.successors.get(&owner()).copied().unwrap_or(NOBODY))],
            "epochOf" => vec![number(known(&self.epochs))],
            "uploadedAt" => vec![number(known(&self.uploads))],
            "grantOf" => {
                let grant = self.grant(owner(), values.address(1));
                let numbers = [number(grant.epoch), number(grant.expiry), number(grant.revokes)];
                [AbiToken::Bool(grant.active)].into_iter().chain(numbers).chain([word(grant.scope)]).collect()
            }
            "envelopeOf" => {
                let given = self.envelopes.get(&(owner(), values.address(1), values.number(2)));
                let (revokes, keys) = given.copied().unwrap_or_default();
                vec![number(revokes), number(keys)]
            }
            "headOf" => vec![word(self.heads.get(&owner()).copied().unwrap_or(ZERO))],
            "anchorOf" => {
                let (block, count) = self.anchors.get(&(owner(), values.word(1))).copied().unwrap_or_default();
                vec![number(block), number(count)]
            }
            "loanOf" => {
                let (active, until) = self.loans.get(&(owner(), values.word(1))).copied().unwrap_or_default();
                vec![AbiToken::Bool(active), number(until)]
            }
            "accountOf" => self.account_of(owner()),
            "dataQuery" => self.data_query(by, &values.bytes(0), values.address(1))?,
            other => panic!("the model knows no {other}"),
        })
    }

    fn account_of(&self, owner: Address) -> Vec<AbiToken> {
        let Account { epoch, count, keys, suspended, token, last, identity } = self.account(owner);
        let front = [AbiToken::Bytes(identity), number(epoch), word(token), AbiToken::Bool(suspended)];
        front.into_iter().chain([number(keys), number(count), word(last)]).collect()
    }

    fn data_query(&self, by: Caller, token: &[u8], owner: Address) -> Result<Vec<AbiToken>, Reason> {
        let epoch = self.epochs.get(&(owner, exact(token)?)).copied().unwrap_or(0);
        let authorised = epoch != 0 && self.may_read(owner, by.sender, epoch, by.now);
        let account = if authorised { self.account(owner) } else { Account::default() };
        Ok(vec![AbiToken::Bool(authorised), number(epoch), number(account.count), word(account.last)])
    }
}
