//! What a session may ask, and the order of its checks: token, then signature, then account, then the desk.

use crate::crypto::signer_id;
use crate::error::{Code, Refusal};
use crate::frame::Message;
use crate::gateway::command::relay::{LONGEST_FOR_VISITOR, LONGEST_RESULT};
use crate::gateway::command::{Answer, Command, RelayCall, Relayed, Request, Upload};
use crate::gateway::desk::{Binding, BoundDevice, Caller, Desk};
use crate::gateway::hello::Agreed;
use crate::gateway::identity_check::{
    allocate, check_account, check_reach, check_records, check_registration, check_signed, check_token,
};
use crate::gateway::limits::Charge;
use crate::gateway::standings::SignedStandings;
use crate::model::{Digest, ProfileName, Timestamp};

use super::{Feeds, Shared};

impl Shared {
    pub(super) async fn allocation_answer(
        &self,
        agreed: &Agreed,
        name: &ProfileName,
        message: &Message<()>,
    ) -> Result<Answer, Refusal> {
        if !message.command.is_for_allocation() {
            return Err(Refusal::new(Code::NotHere, format_args!("{:?} without a transport key", message.command)));
        }
        match Request::parse(message.command, &message.body)? {
            Request::SystemKeys => Ok(Answer::SystemKeys(self.list().1)),
            Request::Ping => Ok(Answer::Time(Timestamp::now())),
            Request::Relay(call) => relayed(self.desk.as_ref(), None, &call).await,
            Request::Register(registration) => {
                check_registration(&self.context, &registration)?;
                self.desk.register(&registration).await.map(Answer::Registered)
            }
            Request::KeyAllocation(request) => {
                let now = Timestamp::now();
                let secret = self.with_cabinet(|cabinet| cabinet.secret(&request.system_key, now).cloned());
                // One at a time: nobody else writes a binding between reading and writing it.
                let _held = self.binding.lock().await;
                let desk = self.desk.as_ref();
                let digest = allocate(&self.context, desk, agreed, name, &request, secret.as_ref()).await?;
                let receipt = self.receipt(Timestamp::now(), vec![digest])?;
                Ok(Answer::Receipt(Command::KeyAllocation, receipt))
            }
            _ => Err(Refusal::new(Code::NotHere, "a command for another session")),
        }
    }
}

async fn relayed(desk: &dyn Desk, caller: Option<&Caller>, call: &RelayCall) -> Result<Answer, Refusal> {
    let parameters = serde_json::from_str(&call.parameters).map_err(Refusal::because(Code::Malformed))?;
    let most = if caller.is_some() { LONGEST_RESULT } else { LONGEST_FOR_VISITOR };
    Relayed::of(desk.relay(caller, &call.method, &parameters).await, most).map(Answer::Relayed)
}

/// What a session under a transport key may do.
pub(super) struct Commands {
    pub agreed: Agreed,
    pub caller: Caller,
    pub binding: Binding,
    pub feeds: Option<Feeds>,
}

impl Commands {
    pub async fn answer(&mut self, shared: &Shared, message: &Message<Charge>) -> Result<Answer, Refusal> {
        let desk = shared.desk.as_ref();
        check_token(desk, &self.caller, message.token).await?;
        desk.admits(&self.caller.account).await?;
        let request = Request::parse(message.command, &message.body)?;
        if message.command.is_signed() {
            check_signed(&shared.context, &self.agreed, &self.caller, message)?;
        }
        check_reach(&self.caller, &request)?;
        match request {
            Request::Ping => return Ok(Answer::Time(Timestamp::now())),
            Request::SystemKeys => return Ok(Answer::SystemKeys(shared.list().1)),
            // Also for an account that is suspended or has other keys by now: the chain itself tells it so.
            Request::Relay(call) => return relayed(desk, Some(&self.caller), &call).await,
            Request::Upload(upload) => return self.store(shared, message.command, vec![upload]).await,
            Request::UploadMany(uploads) => return self.store(shared, message.command, uploads).await,
            _ => check_account(desk, &self.binding).await?,
        }
        match request {
            Request::Query(query) => desk.query(&self.caller, &query).await.map(Answer::Page),
            Request::Check(digests) => {
                let stood = desk.check(&self.caller, &digests).await?;
                let (domain, identity) = (&shared.context.domain, &shared.identity);
                let signed = SignedStandings::sign(shared.provider(), domain, identity, &digests, stood);
                signed.map(|signed| Answer::Standings(Box::new(signed))).map_err(Refusal::because(Code::Internal))
            }
            Request::Fetch(digest) => self.fetch(desk, &digest).await,
            Request::Subscribe(selection) => {
                let feeds = self.feeds.get_or_insert_with(Feeds::new);
                feeds.check_room(message.request, shared.limits().subscriptions)?;
                let entries = desk.subscribe(&self.caller, &selection).await?;
                feeds.add(message.request, entries);
                Ok(Answer::Done(Command::Subscribe))
            }
            Request::Unsubscribe(subscription) => {
                self.end_feed(subscription);
                Ok(Answer::Done(Command::Unsubscribe))
            }
            Request::GrantNotice(notice) => {
                desk.grant(&self.caller, &notice).await?;
                self.noted(shared, message)
            }
            Request::RevokeNotice(notice) => {
                desk.revoke(&self.caller, &notice).await?;
                self.noted(shared, message)
            }
            Request::DeviceNotice(notice) => {
                shared.provider().check_public_key(&notice.key).map_err(Refusal::because(Code::Malformed))?;
                desk.device(&self.caller, &notice).await?;
                let device = BoundDevice { id: signer_id(&notice.key), notices: notice.notices };
                (self.caller.device, self.binding.device) = (Some(device), Some(device));
                self.noted(shared, message)
            }
            Request::Erase(erasures) => desk.erase(&self.caller, erasures).await.map(Answer::Erasures),
            _ => Err(Refusal::new(Code::NotHere, "a command for a session without a transport key")),
        }
    }

    /// A record, or what is left of it if its owner had it erased. Notices to a device are not erased.
    async fn fetch(&self, desk: &dyn Desk, digest: &Digest) -> Result<Answer, Refusal> {
        match desk.fetch(&self.caller, digest).await {
            Err(refusal) if refusal.code == Code::NotFound && self.caller.device.is_none() => {
                desk.fetch_erased(&self.caller, digest).await.map(|erased| Answer::Erased(Box::new(erased)))
            }
            record => record.map(|record| Answer::Record(Box::new(record))),
        }
    }

    /// A subscription delivers under the same conditions as a request: an account that was dismissed, or whose keys
    /// have changed since the session was allocated, gets nothing more.
    ///
    /// # Errors
    /// [`Refusal`], with which the subscription ends.
    pub async fn check_fed(&self, desk: &dyn Desk) -> Result<(), Refusal> {
        desk.admits(&self.caller.account).await?;
        check_account(desk, &self.binding).await
    }

    /// Ends a subscription, if there is one with this number.
    pub fn end_feed(&mut self, request: u32) {
        self.feeds.iter_mut().for_each(|feeds| feeds.remove(request));
    }

    fn noted(&self, shared: &Shared, message: &Message<Charge>) -> Result<Answer, Refusal> {
        let digest = Digest(shared.provider().sm3(&[&message.body]));
        let receipt = shared.receipt(Timestamp::now(), vec![digest])?;
        Ok(Answer::Receipt(message.command, receipt))
    }

    async fn store(&self, shared: &Shared, command: Command, uploads: Vec<Upload>) -> Result<Answer, Refusal> {
        let desk = shared.desk.as_ref();
        let records = check_records(shared.context, desk, &self.caller, uploads).await?;
        check_account(desk, &self.binding).await?;
        let digests = records.iter().map(|record| record.digest).collect();
        let time = desk.store(&self.caller, records).await?;
        shared.receipt(time, digests).map(|receipt| Answer::Receipt(command, receipt))
    }
}
