//! The gateway asks each gateway that its keeper named what that one holds, and takes what it lacks. Both sides do, so
//! records go both ways. A connection that breaks is opened again after pauses that grow; nothing waits for it.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::task::block_in_place;

use super::copies::Copies;
use super::fellows::{Fault, Fellow};
use super::reserved::gateway_of;
use super::round::{Course, Ended, Round, reconcile};
use super::taking::Taking;
use super::{Gateway, GatewayDesk};
use crate::crypto::{random_bytes, signer_id};
use crate::gateway::{Applicant, Client, Code, Context, Credentials, Endpoint, GatewayError, Trust};
use crate::model::{ProfileName, SignerId, Timestamp, clean};
use crate::pipeline::Network;
use crate::service::command::{self as ask, Ask, FleetCommand};
use crate::service::event::{NoticeLevel, Part};
use crate::service::figures::FellowFigures;
use crate::service::reply::{Failure, FellowView, FleetView, PartHealth, Reply};

/// How often each gateway is asked, at most.
const PERIOD: Duration = Duration::from_millis(500);
/// How often any gateway is: in a large fleet each is asked less often.
const BETWEEN: Duration = Duration::from_millis(150);
/// How long it may take to answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// The line to one gateway.
struct Line {
    fellow: Fellow,
    trust: Trust,
    credentials: Option<Credentials>,
    client: Option<Client>,
    course: Course,
}

impl Gateway {
    /// Answers a request about the fleet.
    pub(in crate::site) async fn of_fleet(
        self: &Arc<Self>,
        profile: &ProfileName,
        command: FleetCommand,
    ) -> Result<Reply, Failure> {
        match command {
            FleetCommand::AddFellow { address, key } => {
                let own = self.served().map(|view| view.gateway);
                self.fellows.add(profile, (&address, key), own).await?;
                self.fellow_rows().map(ask::AddFellow::told)
            }
            FleetCommand::RemoveFellow { gateway } => {
                self.fellows.remove(profile, &gateway).await?;
                self.fellow_rows().map(ask::RemoveFellow::told)
            }
            FleetCommand::ListFellows => self.fellow_rows().map(ask::ListFellows::told),
            FleetCommand::FleetStatus => {
                let served = self.served();
                let (address, key) =
                    (served.as_ref().map(|view| view.address.clone()), served.map(|view| view.gateway));
                let held = block_in_place(|| self.plant.ledger.held_although_erased())?;
                let (fellows, copies) = (self.fellow_rows()?, self.config.fleet_copies);
                Ok(ask::FleetStatus::told(FleetView { address, key, fellows, held, copies }))
            }
        }
    }

    /// The state of the fleet, if there is one.
    pub(in crate::site) fn fleet_health(&self) -> Result<Option<PartHealth>, Failure> {
        self.fellows.health()
    }

    /// The figures of each other gateway of the fleet.
    pub(in crate::site) fn fleet_figures(&self) -> Result<Vec<FellowFigures>, Failure> {
        self.fellows.figures()
    }

    fn fellow_rows(&self) -> Result<Vec<FellowView>, Failure> {
        let mut rows = self.fellows.rows(self.link.network_now().as_ref())?;
        if self.config.fleet_copies.is_some() {
            let there = self.fellows.there(self.config.fleet_away_after);
            rows.iter_mut().for_each(|row| row.away = !there.contains(&row.key));
        }
        Ok(rows)
    }

    /// Follows every gateway of the list, until the site ends.
    pub(in crate::site) async fn reconcile(self: Arc<Self>) {
        let followed: Arc<Mutex<BTreeSet<(SignerId, String)>>> = Arc::default();
        while self.life.beat(PERIOD).await {
            let list = block_in_place(|| self.fellows.all()).unwrap_or_default();
            for fellow in list.iter().cloned() {
                let name = (fellow.key, fellow.address.clone());
                if !followed.lock().unwrap_or_else(PoisonError::into_inner).insert(name.clone()) {
                    continue;
                }
                let (gateway, followed) = (Arc::clone(&self), Arc::clone(&followed));
                tokio::spawn(async move {
                    gateway.follow(fellow).await;
                    followed.lock().unwrap_or_else(PoisonError::into_inner).remove(&name);
                });
            }
        }
    }

    /// Asks one gateway again and again, until it is named no more or the site ends.
    async fn follow(self: Arc<Self>, fellow: Fellow) {
        let trust = Trust::pinned(fellow.key);
        let mut line = Line { fellow, trust, credentials: None, client: None, course: Course::default() };
        while self.life.beat(self.period()).await && self.fellows.has(&line.fellow) {
            if !self.fellows.is_due(line.fellow.key) {
                continue;
            }
            let Some(desk) = self.served_desk() else {
                line.client = None;
                continue;
            };
            // Without its chain it could judge nothing that it is handed.
            let Ok(network) = desk.known_network() else { continue };
            let mut more = true;
            while more && !self.life.is_stopping() {
                more = tokio::select! {
                    more = self.one_round(&desk, &network, &mut line) => more,
                    () = self.life.stopped() => false,
                };
            }
        }
    }

    /// The desk of the gateway that runs here, if one does.
    pub(super) fn served_desk(self: &Arc<Self>) -> Option<GatewayDesk> {
        let serving = self.serving.lock().unwrap_or_else(PoisonError::into_inner);
        serving.as_ref().map(|serving| self.desk(&serving.place))
    }

    /// Returns whether there is more to do at once.
    async fn one_round(&self, desk: &GatewayDesk, network: &Network, line: &mut Line) -> bool {
        let mut round = Round::default();
        let ended = self.ask(desk, network, line, &mut round).await;
        let taken = round.taken + round.erased.values().sum::<u64>();
        self.tell_erased(desk, &line.fellow, &round).await;
        // One that only talks is not listened to without a pause.
        let more = round.more && taken > 0 && ended.is_ok();
        self.note(line, round, ended.is_ok());
        match ended {
            Ok(()) => self.fellows.succeeded(&line.fellow),
            // The chain here is silent, or the disk is full.
            Err(Ended::Here(refusal)) => {
                let why = format!("this gateway takes nothing now: {refusal}");
                let fault = if refusal.code == Code::Stale { Fault::Waits } else { Fault::Fails };
                self.fellows.failed(&line.fellow, &why, fault, share());
            }
            Err(Ended::Gateway(error @ GatewayError::Refused(Code::Stale))) => {
                self.fellows.failed(&line.fellow, &told(&error), Fault::Waits, share());
            }
            Err(Ended::Gateway(error)) => {
                line.client = None;
                if matches!(error, GatewayError::RefusedInClear(Code::Tag) | GatewayError::Refused(Code::NotRegistered))
                {
                    line.credentials = None;
                }
                self.fellows.failed(&line.fellow, &told(&error), Fault::Fails, share());
            }
            Err(Ended::Lies(why)) => {
                line.client = None;
                self.fellows.failed(&line.fellow, &why, Fault::Lies, share());
            }
        }
        if taken > 0 {
            self.hub.changed(Part::Health);
        }
        more
    }

    /// Writes down what is erased here at a word from elsewhere, and whose.
    async fn tell_erased(&self, desk: &GatewayDesk, fellow: &Fellow, round: &Round) {
        for (owner, count) in &round.erased {
            let (subject, outcome) = (format!("{count} records of {owner}"), format!("told by {}", fellow.address));
            if let Err(failure) = self.log.write(&desk.keeper.profile, "fleet erase", &subject, &outcome).await {
                self.hub.notice(NoticeLevel::Warning, &failure.message);
            }
        }
    }

    fn note(&self, line: &Line, round: Round, whole: bool) {
        self.fellows.of(line.fellow.key, |one| {
            one.taken += round.taken;
            one.erased += round.erased.values().sum::<u64>();
            one.twice += round.twice;
            for (code, count) in round.refused {
                *one.refused.entry(code).or_default() += count;
            }
            one.passed_over = line.course.passed_over();
            if whole {
                one.heard = Some(Timestamp::now());
                (one.lacking, one.complete) = (round.lacking, line.course.is_at_end());
            }
        });
    }

    async fn ask(
        &self,
        desk: &GatewayDesk,
        network: &Network,
        line: &mut Line,
        round: &mut Round,
    ) -> Result<(), Ended> {
        if line.client.as_ref().is_none_or(Client::is_spent) {
            line.client = None;
            let client = self.connect(desk, network, line).await.map_err(Ended::Gateway)?;
            line.client = Some(client);
            line.course.connected();
        }
        let Some(client) = &mut line.client else { return Ok(()) };
        let here = Taking { desk, anchors: &self.anchors, copies: self.copies(desk) };
        reconcile(client, &here, &mut line.course, round).await
    }

    fn period(&self) -> Duration {
        let many = self.fellows.all().map_or(0, |list| list.len());
        PERIOD.max(BETWEEN * u32::try_from(many).unwrap_or(u32::MAX))
    }

    /// Which records are kept here: `fleet.copies` of the gateways that are there keep each.
    pub(super) fn copies(&self, desk: &GatewayDesk) -> Copies {
        let own = signer_id(&desk.keeper.gateway_identity().public);
        let there = self.fellows.there(self.config.fleet_away_after);
        Copies::of(self.plant.provider, self.config.fleet_copies, own, there)
    }

    /// A session in the keeper's name; the transport key is in memory only and allocated anew by each run.
    async fn connect(&self, desk: &GatewayDesk, network: &Network, line: &mut Line) -> Result<Client, GatewayError> {
        let (keeper, provider) = (&desk.keeper, self.plant.provider);
        let context = Context { provider, domain: network.domain };
        let endpoint = Endpoint { address: line.fellow.address.clone(), context, patience: PATIENCE };
        let token = network.directory.account(keeper.address).and_then(|account| account.token);
        let token = token.ok_or(GatewayError::Unexpected("the keeper of this gateway has no token on the chain"))?;
        if let Some(mut credentials) = line.credentials.clone() {
            credentials.token = token;
            return Client::connect(&endpoint, &mut line.trust, &credentials).await;
        }
        let name = gateway_of(&signer_id(&keeper.gateway_identity().public));
        let name: ProfileName = name.parse().map_err(|_| GatewayError::Unexpected("no name of this gateway"))?;
        let (signing, account, (_, envelope)) = (keeper.signing(), keeper.eoa(), keeper.public_keys());
        let applicant = Applicant { name: &name, signing: &signing, envelope, account: &account };
        let (key, _) = Client::allocate(&endpoint, &mut line.trust, &applicant).await?;
        let credentials = line.credentials.insert(Credentials { name, key, token });
        Client::connect(&endpoint, &mut line.trust, credentials).await
    }
}

/// Why a gateway of the fleet tells nothing, in words for its keeper.
fn told(error: &GatewayError) -> String {
    match error {
        GatewayError::Refused(Code::NotAuthorised) => {
            "its keeper has not named the gateway of this home; it does so by `authros fleet add` with the address and key that \
             `authros fleet status` shows here"
                .to_owned()
        }
        GatewayError::Closed => {
            "it closed the session without an answer; it may be of an earlier version, or just stopping".to_owned()
        }
        error => clean(&error.to_string(), 300),
    }
}

/// Of 256, how much of a pause is left out; none without random bytes.
fn share() -> u8 {
    random_bytes::<1>().map_or(0, |[byte]| byte)
}
