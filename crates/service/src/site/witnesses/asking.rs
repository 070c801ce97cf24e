//! How a witness is asked: its gateway is visited, and what it answers is checked before it counts.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::{ABOUT, LOOK, Witnesses};
use crate::gateway::{Client, Code, Context, Endpoint, GatewayError, Trust};
use crate::model::{ErrorKind, clean};
use crate::pipeline::countersigning::{Answered, answered, stated};
use crate::pipeline::{Network, Owner};
use crate::service::event::NoticeLevel;
use crate::service::failure::{input, refused};
use crate::service::reply::{Failure, GivenView, WitnessAnswers};
use crate::site::blocking;
use crate::store::WitnessRow;

/// How long a gateway may take to answer.
const PATIENCE: Duration = Duration::from_secs(20);
/// The most statements in one visit: a visitor has few frames.
const AT_ONCE: usize = 4;

impl Witnesses {
    /// Asks those that are due, until the site ends.
    pub async fn keep(self: Arc<Self>) {
        while self.life.beat(LOOK).await {
            let Some(network) = self.link.network_now() else { continue };
            let Ok(rows) = blocking(&self, |witnesses| Ok(witnesses.plant.ledger.witnesses()?)).await else { continue };
            let _turn = self.turn.lock().await;
            for row in rows.iter().filter(|row| row.address.is_some()) {
                let again = self.with(|last| last.get(&(row.owner, row.key)).and_then(|last| last.again));
                let owner = self.owners.all().into_iter().find(|owner| owner.address == row.owner);
                if let Some(owner) = owner.filter(|_| again.is_none_or(|again| again <= Instant::now())) {
                    drop(self.ask(&network, &owner, row).await);
                }
            }
        }
    }

    /// Asks all witnesses of an owner now.
    pub(super) async fn ask_now(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<WitnessAnswers, Failure> {
        let mut rows = self.of(owner.address).await?;
        rows.retain(|row| row.address.is_some());
        if rows.is_empty() {
            return Err(input("there is no witness to ask; add one with `authros witness add HOST:PORT`"));
        }
        let network = self.link.network().await?;
        let _turn = self.turn.lock().await;
        let (mut given, mut problem) = (Vec::new(), None);
        for row in &rows {
            match self.ask(&network, owner, row).await {
                Ok(more) => given.extend(more),
                Err(failure) => drop(problem.get_or_insert(failure)),
            }
        }
        match problem {
            Some(failure) if given.is_empty() => Err(failure),
            problem => Ok(WitnessAnswers { given, problem: problem.map(|failure| failure.message) }),
        }
    }

    /// Asks one witness for what it has not countersigned, and notes what came of it.
    async fn ask(
        self: &Arc<Self>,
        network: &Network,
        owner: &Arc<Owner>,
        row: &WitnessRow,
    ) -> Result<Vec<GivenView>, Failure> {
        let result = self.visit(network, owner, row).await;
        match &result {
            Ok(_) => self.succeeded(row),
            Err(failure) => self.failed(row, failure),
        }
        result
    }

    async fn visit(&self, network: &Network, owner: &Arc<Owner>, row: &WitnessRow) -> Result<Vec<GivenView>, Failure> {
        let of = (owner.address, row.key);
        let mut last = block_in_place(|| self.plant.ledger.newest_position(of, network.domain))?;
        let (mut given, mut client, mut referred) = (Vec::new(), None, false);
        while given.len() < AT_ONCE {
            let Some(next) = stated(&self.plant, network, owner, row.key, last.as_ref()).await? else { break };
            let position = next.signed.position;
            if let Some(found) = last.and_then(|last| position.contradicts(&last.stated.position)) {
                let text = format!(
                    "the witness '{}' countersigned another history of this chain: {found}. It was rewritten, or this \
                     home was restored; the witness will say so",
                    row.name
                );
                self.hub.notice_about(ABOUT, NoticeLevel::Error, &text);
            }
            let client = match &mut client {
                Some(client) => client,
                client @ None => client.insert(self.connect(row).await.map_err(|error| told(row, error))?),
            };
            let answer = client.countersign(&next.signed).await.map_err(|error| told(row, error))?;
            let batches = next.batches.roots.len() as u64;
            match block_in_place(|| answered(&self.plant, row, next, answer))? {
                Answered::Countersigned(at) => {
                    given.push(GivenView { witness: row.name.clone(), at, batches, block: position.block });
                    last = Some(answer);
                }
                Answered::Last(_) if referred => {
                    return Err(refused(format!(
                        "the witness '{}' answered twice with its last statement and did not countersign",
                        row.name
                    )));
                }
                Answered::Last(found) => (last, referred) = (Some(*found), true),
            }
        }
        Ok(given)
    }

    /// A visit at the witness's gateway, on whichever network that is.
    async fn connect(&self, row: &WitnessRow) -> Result<Client, GatewayError> {
        let address = row.address.clone().unwrap_or_default();
        let named = Client::inquire(std::slice::from_ref(&address), PATIENCE).await?;
        let context = Context { provider: self.plant.provider, domain: named.domain() };
        let endpoint = Endpoint { addresses: vec![address], context, patience: PATIENCE };
        let visitor = "witnessed".parse().map_err(|_| GatewayError::Unexpected("no name of a visitor"))?;
        Client::visit(&endpoint, &mut Trust::pinned(row.key), &visitor).await
    }
}

/// Why a witness gave nothing, in words for the operator.
fn told(row: &WitnessRow, error: GatewayError) -> Failure {
    let name = clean(&row.name, 80);
    match error {
        GatewayError::Refused(Code::Tampered) => Failure::new(
            ErrorKind::Tampered,
            format!(
                "the witness '{name}' holds an earlier statement that contradicts this one: the chain was rewritten, or \
                 this home was restored from an earlier state; both operators have to settle it (docs/evidence.md)"
            ),
        ),
        GatewayError::Refused(Code::NotAuthorised | Code::Account) => refused(format!(
            "the witness '{name}' does not serve this profile; its operator adds the account and key that `authros witness \
             status` shows, with --serve"
        )),
        GatewayError::Closed => Failure::new(
            ErrorKind::Unreachable,
            format!("the gateway of the witness '{name}' closed the session; it may be of an earlier version"),
        ),
        error => {
            let failure = Failure::from(error);
            Failure { message: format!("the witness '{name}': {}", failure.message), ..failure }
        }
    }
}
