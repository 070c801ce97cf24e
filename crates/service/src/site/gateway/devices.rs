//! Names that belong to devices: they end with the loan, wherever the chain says that it ended.

use super::GatewayDesk;
use crate::gateway::{Caller, Code, Refusal};
use crate::model::{Address, SignerId};
use crate::pipeline::Network;
use crate::pipeline::authority::{Moment, may_sign};

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
