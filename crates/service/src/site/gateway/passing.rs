//! Requests to the chain that a gateway forwards: reads for everybody, transactions for those who may use the gateway,
//! and a newcomer's registration.

use serde_json::{Value, json};

use super::GatewayDesk;
use super::reading::LONGEST_SILENCE;
use crate::chain::RelayError;
use crate::chain::relay::{Asker, Ground, Passed, examine};
use crate::gateway::identity_check::check_registration;
use crate::gateway::{Caller, Context, Registration};
use crate::model::{Address, Identity};
use crate::pipeline::{Network, authority};

fn rejected(words: &str) -> RelayError {
    RelayError::Answered { code: -32003, message: words.to_owned(), data: None }
}

impl GatewayDesk {
    /// Forwards a request to the chain, if it is allowed.
    pub(super) async fn pass_on(
        &self,
        caller: Option<&Caller>,
        method: &str,
        parameters: &Value,
    ) -> Result<Value, RelayError> {
        let network = self.known_network().map_err(|refusal| RelayError::Silent(refusal.to_string()))?;
        let (Some(pin), Some(head)) = (network.chain.pin(), self.gateway.link.fresh_head(LONGEST_SILENCE)) else {
            return Err(RelayError::Silent("no recent block from the chain".to_owned()));
        };
        let asker = if caller.is_some() { Asker::Registered } else { Asker::Visitor };
        match examine(Ground { pin: &pin, head: head.number }, asker, method, parameters)? {
            Passed::Read(parameters) => network.chain.relay(method, &parameters).await,
            Passed::NoLogs => Ok(json!([])),
            Passed::Estimate { from, registers } => {
                let known = || from.is_some_and(|from| self.may_send(&network, &from));
                if caller.is_none() && registers.is_none() && !known() {
                    return Err(RelayError::NotAllowed);
                }
                network.chain.relay(method, parameters).await
            }
            Passed::Transaction { sender, raw, registers } => {
                if caller.is_none() {
                    self.check_sender(&network, sender, registers, raw)?;
                }
                network.chain.relay(method, parameters).await
            }
        }
    }

    /// A transaction proves its sender by itself: without a transport key, accounts that may use this gateway may still
    /// send one, and a newcomer may send its registration.
    fn check_sender(
        &self,
        network: &Network,
        sender: Address,
        registers: Option<Box<Identity>>,
        transaction: Vec<u8>,
    ) -> Result<(), RelayError> {
        if let Some(identity) = registers {
            let context = Context { provider: self.gateway.plant.provider, domain: self.domain };
            let registration = Registration { account: sender, identity: *identity, transaction };
            return check_registration(&context, &registration)
                .map_err(|_| rejected("the identity being registered is not proven by its own keys"));
        }
        if self.may_send(network, &sender) {
            return Ok(());
        }
        Err(rejected(
            "a visitor may only send its registration; ask the gateway's operator to admit this account first",
        ))
    }

    /// Whether an account is registered, not suspended, and may use this gateway.
    fn may_send(&self, network: &Network, account: &Address) -> bool {
        let known =
            network.directory.account(*account).is_some() && !authority::is_suspended(&network.directory, *account);
        known && self.standing_of(network, account).is_ok()
    }
}
