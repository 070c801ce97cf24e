//! Names that belong to devices: they end with the loan, wherever the chain says that it ended. The owners of names
//! bound before gateways stored them are found in this gateway's own audit log.

use super::Gateway;
use std::collections::BTreeMap;

use super::GatewayDesk;
use crate::gateway::{Caller, Code, Refusal};
use crate::model::{Address, SignerId};
use crate::pipeline::Network;
use crate::pipeline::authority::{Moment, may_sign};
use crate::service::reply::Failure;
use crate::store::AuditQuery;

/// The setting that says that earlier names have been looked up.
const RESOLVED: &str = "gateway devices resolved";
/// Lines of the audit log to search.
const LINES: usize = 1_000_000;

impl GatewayDesk {
    /// Whether the newest loan of a device was recalled; a later loan is valid again.
    pub(super) fn is_recalled(&self, owner: &Address, device: &SignerId) -> Result<bool, Refusal> {
        let account = self.known_network()?.directory.account(*owner);
        let loans = account.map(|account| account.devices).unwrap_or_default();
        Ok(loans.iter().rfind(|loan| loan.device == *device).is_some_and(|loan| loan.recalled.is_some()))
    }

    /// A device's session is valid as long as its loan.
    pub(super) fn check_loan(&self, network: &Network, caller: &Caller) -> Result<(), Refusal> {
        let Some(device) = &caller.device else { return Ok(()) };
        let now = Moment::newest(network.directory.now());
        let right = may_sign(&network.directory, caller.account, device.id, now);
        right.map(drop).map_err(|why| Refusal::new(Code::NotAuthorised, format_args!("device {}: {why}", device.id)))
    }
}

impl Gateway {
    /// Finds, once, the devices of names bound by an earlier version: it logged which name brought which device's key,
    /// after the name was allocated.
    pub(super) fn resolve_devices(&self) -> Result<(), Failure> {
        let ledger = &self.plant.ledger;
        if ledger.setting(RESOLVED)?.is_some() {
            return Ok(());
        }
        let lines = |action: &str| {
            let query = AuditQuery { action: Some(action.to_owned()), limit: LINES, ..AuditQuery::default() };
            self.log.lines().list(&query)
        };
        let mut told: BTreeMap<String, (u64, Address, SignerId)> = BTreeMap::new();
        for line in lines("device notice")? {
            let Some((name, account)) = asker(&line.entry.outcome) else { continue };
            let Ok(device) = line.entry.subject.parse() else { continue };
            let newest = told.entry(name).or_insert((line.line, account, device));
            if newest.0 <= line.line {
                *newest = (line.line, account, device);
            }
        }
        let mut allocated: BTreeMap<String, u64> = BTreeMap::new();
        for line in lines("allocate key")? {
            let Some((name, _)) = line.entry.subject.split_once(" for ") else { continue };
            let newest = allocated.entry(name.to_owned()).or_default();
            *newest = (*newest).max(line.line);
        }
        for (name, (line, account, device)) in told {
            // A name that was allocated again since is not known to be the device's.
            if allocated.get(&name).is_none_or(|allocated| *allocated < line) {
                ledger.bind_device(&name, account, device, None)?;
            }
        }
        Ok(ledger.put_setting(RESOLVED, "1")?)
    }
}

/// Name and account of `asked by NAME (ACCOUNT)`, as the desk writes it.
fn asker(outcome: &str) -> Option<(String, Address)> {
    let (name, account) = outcome.strip_prefix("asked by ")?.rsplit_once(" (")?;
    Some((name.to_owned(), account.strip_suffix(')')?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_asker_is_read_as_the_desk_writes_it() {
        let account = Address([7; 20]);
        assert_eq!(asker(&format!("asked by scout-1 ({account})")), Some(("scout-1".to_owned(), account)));
        for other in ["begun", "asked by scout-1", "asked by scout-1 (0x12)"] {
            assert_eq!(asker(other), None, "{other}");
        }
    }
}
