//! The administrator's acts, and reports of successions.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use crate::chain::Call;
use crate::command::Administration;
use crate::crypto::EoaSecret;
use crate::model::{Address, Party, Timestamp, counted};
use crate::pipeline::{Network, Owner};
use crate::reply::{
    AdministrationView, Part, ProposalView, RecoveryView, Result, SuccessionView, TransactionView, refused,
};
use crate::site::{Contacts, Parts};

/// Default length of a pause, seconds.
const PAUSE: u64 = 86_400;

pub struct Administering {
    pub parts: Parts,
    pub contacts: Arc<Contacts>,
}

impl Administering {
    /// The contract refuses acts of anybody else, except those open to others.
    pub async fn administer(&self, owner: &Owner, act: &Administration) -> Result<TransactionView> {
        use Administration::{Accept, Cancel, Complete};
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        let (call, text) = self.act(&network, act)?;
        if let Some(administrator) = network.directory.administration().administrator
            && administrator != owner.address
            && !matches!(act, Accept | Cancel { .. } | Complete { .. })
        {
            return Err(refused(format!(
                "the administrator of this contract is {administrator}, not {}; only the administrator can do this",
                owner.address
            )));
        }
        self.send_act(owner, &network, call, text).await
    }

    pub async fn name_recovery(&self, owner: &Owner, recovery: Option<&Party>) -> Result<TransactionView> {
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        network.directory.identity(owner.address)?;
        let recovery = recovery.map(|party| self.contacts.resolve(party)).transpose()?;
        if recovery == Some(owner.address) {
            return Err(refused(
                "a thief of this account must not be able to stop its succession; name another account",
            ));
        }
        let call = Call::NameRecovery { recovery };
        let days = counted(network.directory.administration().delay / 86_400, "day");
        let who = recovery.map_or_else(|| "nobody".to_owned(), |recovery| recovery.to_string());
        let text = format!("{who} may stop a succession of {} proposed {days} from now or later", owner.address);
        self.send_act(owner, &network, call, text).await
    }

    async fn send_act(&self, owner: &Owner, network: &Network, call: Call, text: String) -> Result<TransactionView> {
        let name = call.name();
        let sent = async { Ok(self.parts.sender.send(&network.chain, &owner.eoa(), call, name).await?) };
        let (transaction, receipt) = self.parts.log.deed(&owner.profile, name, &text, sent).await?;
        self.parts.link.scanned(receipt.block).await;
        self.parts.hub.changed(Part::Chain);
        let epoch = network.directory.epoch(owner.address);
        Ok(TransactionView::mined(transaction, receipt.block, epoch, text))
    }

    /// Does not wait for the owner's changes: one of them may be the cancelled one.
    pub async fn cancel(&self, owner: &Owner, key: &EoaSecret, nonce: u64) -> Result<TransactionView> {
        let network = self.parts.link.network().await?;
        let subject = format!("nonce {nonce} of {}", key.address());
        let cancelled = async { Ok(self.parts.sender.cancel(&network.chain, key, nonce).await?) };
        let cancelled = self.parts.log.deed(&owner.profile, "cancel transaction", &subject, cancelled).await?;
        self.parts.hub.changed(Part::Chain);
        let block = self.parts.sender.wait_cancelled(&network.chain, key, &cancelled).await?;
        if let Some(block) = block {
            self.parts.link.scanned(block).await;
        }
        let what = &cancelled.purpose;
        let text = match (block, cancelled.anchors) {
            (None, _) => format!("{subject} ({what}) was mined before its replacement; nothing was cancelled"),
            (_, true) => format!("{subject} ({what}) is cancelled; its records are anchored again by another one"),
            (_, false) => format!("{subject} ({what}) is cancelled; repeat the command if it is still wanted"),
        };
        let transaction = block.map(|_| cancelled.hash);
        let epoch = network.directory.epoch(owner.address);
        Ok(TransactionView { transaction, block, epoch, text, ..TransactionView::default() })
    }

    fn act(&self, network: &Network, act: &Administration) -> Result<(Call, String)> {
        let resolved = |account: &Party| self.contacts.resolve(account);
        let acted = |account: &Party, call: fn(Address) -> Call, what: &str| -> Result<(Call, String)> {
            let account = resolved(account)?;
            Ok((call(account), format!("{account} {what}")))
        };
        match act {
            Administration::Dismiss { account } => {
                let account = resolved(account)?;
                if network.directory.epoch(account) > 0 {
                    return Err(refused(format!(
                        "{account} has already registered; `authros chain admin suspend` stops it"
                    )));
                }
                Ok((
                    Call::Dismiss { account },
                    format!("{account} can no longer register while registration is closed"),
                ))
            }
            Administration::Admit { account } => acted(account, |account| Call::Admit { account }, "can register"),
            Administration::Suspend { account } => {
                acted(account, |account| Call::Suspend { account }, "is suspended: it can only withdraw rights")
            }
            Administration::Restore { account } => {
                acted(account, |account| Call::Restore { account }, "is no longer suspended")
            }
            Administration::Open { open } => {
                let text = if *open { "anyone can register" } else { "only allowed accounts can register" };
                Ok((Call::SetOpen { open: *open }, text.to_owned()))
            }
            Administration::Pause { paused, seconds } => Ok(pause(*paused, *seconds)),
            Administration::HandOver { account } => {
                let what = "is nominated as administrator; it takes over with `chain admin accept`";
                acted(account, |account| Call::Nominate { account }, what)
            }
            Administration::Accept => {
                Ok((Call::AcceptAdministrator, "this profile administers the contract".to_owned()))
            }
            Administration::Propose { lost, successor } => self.propose(network, lost, successor),
            Administration::Cancel { lost } => {
                let lost = resolved(lost)?;
                Ok((Call::CancelSuccession { lost }, format!("the succession of {lost} is cancelled")))
            }
            Administration::Complete { lost } => {
                let what = "is suspended permanently; its successor continues";
                acted(lost, |lost| Call::CompleteSuccession { lost }, what)
            }
        }
    }

    fn propose(&self, network: &Network, lost: &Party, successor: &Party) -> Result<(Call, String)> {
        let (lost, successor) = (self.contacts.resolve(lost)?, self.contacts.resolve(successor)?);
        network.directory.identity(successor)?;
        let recovery = network.directory.account(lost).and_then(|account| account.recovery);
        let recovery = recovery.and_then(|recovery| recovery.in_effect(Timestamp::now()));
        let delay = network.directory.administration().delay;
        let (days, stops) = match recovery {
            Some(recovery) => (delay / 86_400, format!("{recovery} can stop it until then")),
            None => (2 * delay / 86_400, "there is no recovery account that could stop it".to_owned()),
        };
        let days = counted(days, "day");
        let text = format!("{successor} can continue for {lost} in {days}, with `chain succession complete`; {stops}");
        Ok((Call::ProposeSuccession { lost, successor }, text))
    }

    pub fn view(network: &Network, own: Option<Address>, names: &BTreeMap<Address, String>) -> AdministrationView {
        let (decided, now) = (network.directory.administration(), Timestamp::now());
        let name = |account: &Address| names.get(account).cloned();
        let proposals = decided.proposals.iter().map(|waits| ProposalView {
            lost: waits.lost,
            lost_name: name(&waits.lost),
            successor: waits.successor,
            successor_name: name(&waits.successor),
            recovery: waits.recovery,
            due: waits.due,
            block: waits.block,
        });
        let recovery = own.and_then(|own| network.directory.account(own)?.recovery);
        let recovery = recovery.map(|named| RecoveryView {
            account: named.in_effect(now),
            next: named.next.filter(|_| now < named.from),
            from: (now < named.from).then_some(named.from),
        });
        let successions = decided.successions.iter().map(|named| SuccessionView {
            lost: named.lost,
            lost_name: name(&named.lost),
            successor: named.successor,
            successor_name: name(&named.successor),
            block: named.block,
        });
        AdministrationView {
            administrator: decided.administrator,
            nominee: decided.nominee,
            open: decided.open,
            paused: decided.is_paused(now),
            paused_until: decided.paused_until.filter(|until| now < *until),
            delay: decided.delay,
            proposals: proposals.collect(),
            recovery: recovery.unwrap_or_default(),
            suspended: decided.suspended.iter().copied().collect(),
            successions: successions.collect(),
        }
    }

    pub async fn keep_parties_known(self: Arc<Self>) {
        let mut scanned = self.parts.link.scans();
        let (mut seen, mut told) = (None, HashSet::new());
        while !self.parts.life.is_stopping() {
            tokio::select! {
                changed = scanned.changed() => if changed.is_err() { return },
                () = self.parts.life.stopped() => return,
            }
            let Some(network) = self.parts.link.network_now() else { continue };
            let newest = (network.domain, network.directory.newest());
            if seen.replace(newest) == Some(newest) {
                continue;
            }
            let mut texts = self.succession_texts(&network);
            match self.contacts.changed_contacts(&network) {
                Ok(changed) => texts.extend(changed),
                Err(failure) => texts.push(failure.message),
            }
            for text in texts {
                if told.insert(text.clone()) {
                    self.parts.hub.alarm(&text);
                }
            }
        }
    }

    fn succession_texts(&self, network: &Network) -> Vec<String> {
        let decided = network.directory.administration();
        // Without the address book, addresses stand alone.
        let names = self.contacts.names().unwrap_or_default();
        let shown = |account: &Address| match names.get(account) {
            Some(name) => format!("{name} ({account})"),
            None => account.to_string(),
        };
        let successions = decided.successions.iter().map(|named| {
            let (lost, successor, block) = (shown(&named.lost), shown(&named.successor), named.block);
            format!("the administrator declared {lost} lost and named {successor} its successor (block {block})")
        });
        let proposals = decided.proposals.iter().map(|waits| {
            let (lost, successor) = (shown(&waits.lost), shown(&waits.successor));
            let stop = waits.recovery.map_or_else(
                || "it has no recovery account".to_owned(),
                |recovery| format!("its recovery account {recovery} can stop it: `authros chain succession cancel`"),
            );
            let (due, block) = (waits.due, waits.block);
            format!(
                "the administrator proposed that {successor} continue for {lost} from {due} (block {block}); {stop}"
            )
        });
        successions.chain(proposals).collect()
    }
}

fn pause(paused: bool, seconds: Option<u64>) -> (Call, String) {
    if !paused {
        return (Call::Resume, "changes are possible again".to_owned());
    }
    let until = Timestamp::from_seconds(Timestamp::now().seconds().saturating_add(seconds.unwrap_or(PAUSE)));
    let text = format!(
        "all changes are paused except those that withdraw rights, until {until}; then they resume automatically"
    );
    (Call::Pause { until }, text)
}
