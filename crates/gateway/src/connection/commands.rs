//! Commands of a session. The order of the checks: token, signature, account, desk.

use std::collections::BTreeSet;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};

use crate::crypto::signer_id;
use crate::error::{Code, Refusal, Result};
use crate::feed::{Feed, FeedPage};
use crate::frame::Message;
use crate::gateway::command::relay::{LONGEST_FOR_VISITOR, LONGEST_RESULT};
use crate::gateway::command::{Answer, Command, DeviceNotice, Found, Notice, RelayCall, Relayed, Request, Upload};
use crate::gateway::desk::{Binding, BoundDevice, Caller, Desk};
use crate::gateway::hello::Agreed;
use crate::gateway::identity_check::{allocate, check_account, check_reach, check_records, check_signed};
use crate::gateway::limits::Charge;
use crate::model::{Address, Digest, ProfileName, Timestamp};

use super::Shared;

impl Shared {
    pub(super) async fn allocation_answer(
        &self,
        agreed: &Agreed,
        name: &ProfileName,
        message: &Message<()>,
    ) -> Result<Answer> {
        if !message.command.is_for_allocation() {
            return Err(Refusal::new(Code::NotHere, format_args!("{:?} without a transport key", message.command)));
        }
        match Request::parse(message.command, &message.body)? {
            Request::SystemKeys => Ok(Answer::SystemKeys(self.list().1)),
            Request::Ping => Ok(Answer::Time(Timestamp::now())),
            Request::Relay(call) => relayed(self.desk.as_ref(), None, &call).await,
            Request::KeyAllocation(request) => {
                let now = Timestamp::now();
                let secret = self.system_keys().secret(&request.system_key, now, self.grace).cloned();
                // One at a time: nobody else writes a binding between reading and writing it.
                let _held = self.binding.lock().await;
                let desk = self.desk.as_ref();
                let digest = allocate(&self.context, desk, agreed, name, &request, secret.as_ref()).await?;
                let receipt = self.receipt(Timestamp::now(), vec![digest])?;
                Ok(Answer::Receipt(Command::KeyAllocation, receipt))
            }
            Request::Upload(_)
            | Request::UploadMany(_)
            | Request::Notice(_)
            | Request::Erase(_)
            | Request::Feed(_)
            | Request::Records(..) => Err(Refusal::new(Code::NotHere, "a command for another session")),
        }
    }
}

async fn relayed(desk: &dyn Desk, caller: Option<&Caller>, call: &RelayCall) -> Result<Answer> {
    let parameters = serde_json::from_str(&call.parameters).map_err(Refusal::because(Code::Malformed))?;
    let most = if caller.is_some() { LONGEST_RESULT } else { LONGEST_FOR_VISITOR };
    Relayed::of(desk.relay(caller, &call.method, &parameters).await, most).map(Answer::Relayed)
}

/// Under a transport key.
pub(super) struct Commands {
    pub agreed: Agreed,
    pub caller: Caller,
    pub binding: Binding,
    pub waiting: Option<Waiting>,
    /// Owners whose feed this session has asked for.
    pub followed: BTreeSet<Address>,
}

/// Until the next look while the chain is not fresh.
const AGAIN: Duration = Duration::from_millis(500);

/// Between two looks, however often something changes: all waiting sessions look then.
const LEAST: Duration = Duration::from_millis(50);

pub(super) struct Waiting {
    request: u32,
    asked: Feed,
    until: Instant,
    again: Instant,
    looked: Instant,
    changes: watch::Receiver<u64>,
}

impl Waiting {
    pub fn is_due(&self) -> bool {
        let now = Instant::now();
        self.again <= now || (self.changes.has_changed().unwrap_or(true) && self.looked + LEAST <= now)
    }

    /// Cancel-safe.
    pub async fn due(&mut self) {
        tokio::select! {
            changed = self.changes.changed() => if changed.is_err() { sleep_until(self.again).await },
            () = sleep_until(self.again) => {}
        }
        // Seen by `changed`, but not looked at yet.
        self.again = self.again.min(Instant::now().max(self.looked + LEAST));
        sleep_until(self.again).await;
    }
}

impl Commands {
    /// `None` while the request waits.
    pub async fn answer(&mut self, shared: &Shared, message: &Message<Charge>) -> Result<Option<Answer>> {
        let desk = shared.desk.as_ref();
        let token = message.token.ok_or_else(|| Refusal::new(Code::Token, "no token"))?;
        desk.admits(&self.caller.account, Some(&token)).await?;
        let request = Request::parse(message.command, &message.body)?;
        if message.command.is_signed() {
            check_signed(&shared.context, &self.agreed, &self.caller, message)?;
        }
        check_reach(&self.caller, &request)?;
        match request {
            Request::Feed(asked) => self.follow(shared, message.request, asked).await,
            request => self.answered(shared, message, request).await.map(Some),
        }
    }

    async fn answered(&mut self, shared: &Shared, message: &Message<Charge>, request: Request) -> Result<Answer> {
        let desk = shared.desk.as_ref();
        match request {
            Request::Ping => Ok(Answer::Time(Timestamp::now())),
            Request::SystemKeys => Ok(Answer::SystemKeys(shared.list().1)),
            // Even for a suspended account or changed keys: the chain says so.
            Request::Relay(call) => relayed(desk, Some(&self.caller), &call).await,
            Request::Upload(upload) => self.store(shared, message.command, vec![upload]).await,
            Request::UploadMany(uploads) => self.store(shared, message.command, uploads).await,
            Request::Records(bytes, digests) => {
                check_account(desk, &self.binding).await?;
                let found = desk.records(&self.caller, &digests, bytes).await?;
                for (digest, found) in digests.iter().zip(&found).filter(|_| bytes) {
                    if let Found::Missing(code) = found {
                        shared.refused(self.caller.peer, &Refusal::new(*code, format_args!("record {digest}")));
                    }
                }
                Ok(Answer::Records(found))
            }
            Request::Notice(notice) => {
                check_account(desk, &self.binding).await?;
                if let Notice::Device(notice) = &notice {
                    shared.provider().check_public_key(&notice.key).map_err(Refusal::because(Code::Malformed))?;
                }
                desk.notice(&self.caller, &notice).await?;
                if let Notice::Device(DeviceNotice { key, notices }) = notice {
                    let device = BoundDevice { id: signer_id(&key), notices };
                    (self.caller.device, self.binding.device) = (Some(device), Some(device));
                }
                let digest = Digest(shared.provider().sm3(&[&message.body]));
                let receipt = shared.receipt(Timestamp::now(), vec![digest])?;
                Ok(Answer::Receipt(message.command, receipt))
            }
            Request::Erase(erasures) => {
                check_account(desk, &self.binding).await?;
                desk.erase(&self.caller, erasures).await.map(Answer::Erasures)
            }
            Request::KeyAllocation(_) | Request::Feed(_) => {
                Err(Refusal::new(Code::NotHere, "a command for a session without a transport key"))
            }
        }
    }

    /// `None` leaves the request to [`Self::due`].
    async fn follow(&mut self, shared: &Shared, request: u32, asked: Feed) -> Result<Option<Answer>> {
        if self.waiting.is_some() {
            return Err(Refusal::new(Code::Quota, "one request for the feed is waiting already"));
        }
        // A change after the look rings.
        let (now, changes) = (Instant::now(), shared.desk.changes());
        let until = now + asked.wait;
        self.waiting = Some(Waiting { request, asked, until, again: now, looked: now, changes });
        self.due(shared).await.map(|(_, outcome)| outcome).transpose()
    }

    /// Answers the waiting request with news, a refusal, or at the end of its time; waits on while the chain is not
    /// fresh. Checks the account like any request: one dismissed, or with other keys, gets nothing.
    pub async fn due(&mut self, shared: &Shared) -> Option<(u32, Result<Answer>)> {
        let mut waiting = self.waiting.take()?;
        waiting.changes.mark_unchanged();
        waiting.looked = Instant::now();
        let is_over = Instant::now() >= waiting.until;
        let page = match self.page(shared, &waiting.asked).await {
            Ok(page) if is_over || page.tells(&waiting.asked) => page,
            Ok(page) => {
                waiting.asked.after(&page);
                waiting.again = waiting.until;
                self.waiting = Some(waiting);
                return None;
            }
            Err(refusal) if refusal.code == Code::Stale && !is_over => {
                waiting.again = (Instant::now() + AGAIN).min(waiting.until);
                self.waiting = Some(waiting);
                return None;
            }
            Err(refusal) => return Some((waiting.request, Err(refusal))),
        };
        for (owner, code) in &page.refused {
            shared.refused(self.caller.peer, &Refusal::new(*code, format_args!("records of {owner}")));
        }
        let signed = page.sign(shared.provider(), &shared.context.domain, &shared.identity);
        let answer = signed.map(|page| Answer::Feed(Box::new(page))).map_err(Refusal::internal);
        Some((waiting.request, answer))
    }

    async fn page(&mut self, shared: &Shared, asked: &Feed) -> Result<FeedPage> {
        let desk = shared.desk.as_ref();
        desk.admits(&self.caller.account, None).await?;
        check_account(desk, &self.binding).await?;
        let is_new = asked.places.iter().any(|place| !self.followed.contains(&place.owner));
        let page = desk.feed(&self.caller, asked, is_new).await?;
        self.followed.extend(asked.places.iter().map(|place| place.owner));
        Ok(page)
    }

    async fn store(&self, shared: &Shared, command: Command, uploads: Vec<Upload>) -> Result<Answer> {
        let desk = shared.desk.as_ref();
        let records = check_records(shared.context, desk, &self.caller, uploads).await?;
        check_account(desk, &self.binding).await?;
        let digests = records.iter().map(|record| record.digest).collect();
        let time = desk.store(&self.caller, records).await?;
        shared.receipt(time, digests).map(|receipt| Answer::Receipt(command, receipt))
    }
}
