//! The gateway's end of a connection: hello, then key allocation or commands, one frame after the other.

use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::{collections::BTreeSet, net::SocketAddr, time::Duration};

use tokio::sync::watch;
use tokio::time::{Instant, sleep, sleep_until};

use crate::allocation::{allocate, check_account, check_reach, check_records, check_signed};
use crate::command::messages::{LONGEST_FOR_VISITOR, LONGEST_RESULT};
use crate::command::{
    Answer, Command, DeviceNotice, Found, Inner, Notice, Part, RelayCall, Relayed, Request, Speaker, Upload, split,
};
use crate::crypto::{Provider, SmKeyPair, TransportKey, signer_id};
use crate::desk::{Binding, BoundDevice, Caller, Desk};
use crate::error::{Code, GatewayError, Refusal, Result};
use crate::feed::{Feed, FeedPage};
use crate::frame::{Assembler, FrameKind, Line, LineError, Message};
use crate::hello::{Agreed, Context, GatewayHello, Identified, ListSummary, NetworkName, Purpose};
use crate::limits::{Charge, Limits, Peers, Seat};
use crate::model::{Address, Digest, ProfileName, Timestamp};
use crate::server::{Tally, stopped};
use crate::session::{LONGEST_LIFE, Session};
use crate::system_keys::{Cabinet, Kept};
use crate::{model::relay::weight, model::wire::WireError, receipt::Receipt};

#[cfg(test)]
pub(super) use self::agreed_elsewhere::serve_agreed;

/// Times the hello's patience: an allocation asks the chain.
const ALLOCATION_PATIENCE: u32 = 3;
const MOST_ALLOCATION_FRAMES: usize = 8;
/// Longer frames are charged before they are read; bytes.
const CHARGED: usize = 16 * 1024;
/// Between attempts to get memory for a frame.
const ROOM: Duration = Duration::from_millis(50);

enum Next {
    Frame(FrameKind, Vec<u8>),
    /// A request for the feed may have an answer.
    Due,
}

pub(super) struct Shared {
    pub desk: Arc<dyn Desk>,
    pub context: Context,
    pub identity: SmKeyPair,
    /// Waits for disk or database, so not for network threads.
    pub cabinet: Mutex<Cabinet>,
    /// What it last had.
    pub kept: RwLock<Arc<Kept>>,
    /// Whether other workers have the same cabinet.
    pub has_workers: bool,
    /// A retired key's.
    pub grace: Duration,
    pub peers: Peers,
    /// Held while a name is bound.
    pub binding: tokio::sync::Mutex<()>,
    /// For the operator's display.
    pub tally: Tally,
}

impl Shared {
    fn provider(&self) -> &'static dyn Provider {
        self.context.provider
    }

    fn limits(&self) -> &Limits {
        self.peers.limits()
    }

    pub fn system_keys(&self) -> Arc<Kept> {
        Arc::clone(&self.kept.read().unwrap_or_else(PoisonError::into_inner))
    }

    fn list(&self) -> (ListSummary, Vec<u8>) {
        let kept = self.system_keys();
        (kept.list.summary(self.provider()), kept.list.encode())
    }

    /// What a hello announces: no list older than what another worker may have shown.
    async fn announced(self: &Arc<Self>) -> Result<ListSummary> {
        if self.has_workers {
            let shared = Arc::clone(self);
            let read = tokio::task::spawn_blocking(move || shared.take_over_rotation());
            read.await.map_err(Refusal::internal)?.map_err(Refusal::internal)?;
        }
        Ok(self.list().0)
    }

    fn take_over_rotation(&self) -> Result<(), GatewayError> {
        let mut cabinet = self.cabinet.lock().unwrap_or_else(PoisonError::into_inner);
        cabinet.rotate(Timestamp::now())?;
        if *cabinet.kept() != *self.system_keys() {
            *self.kept.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(cabinet.kept().clone());
        }
        Ok(())
    }

    /// Counts it and reports it to the desk.
    pub fn refused(&self, peer: SocketAddr, refusal: &Refusal) {
        self.tally.refuse(refusal.code);
        self.desk.refused(peer, refusal);
    }

    /// Only when it is time.
    pub fn rotate(&self) {
        if let Err(error) = self.take_over_rotation() {
            self.refused(SocketAddr::from(([0, 0, 0, 0], 0)), &Refusal::internal(error));
        }
    }

    fn receipt(&self, time: Timestamp, digests: Vec<Digest>) -> Result<Receipt> {
        Receipt::sign(self.provider(), &self.context.domain, &self.identity, time, digests).map_err(Refusal::internal)
    }
}

enum End {
    Closed,
    Refused(Refusal),
}

impl From<Refusal> for End {
    fn from(refusal: Refusal) -> Self {
        Self::Refused(refusal)
    }
}

impl From<WireError> for End {
    fn from(error: WireError) -> Self {
        Self::Refused(error.into())
    }
}

impl From<LineError> for End {
    fn from(error: LineError) -> Self {
        match error {
            LineError::Closed(_) => Self::Closed,
            LineError::Frame(error) => Self::Refused(Refusal::new(Code::Length, error)),
            LineError::TooSlow => Self::Refused(Refusal::new(Code::TooSlow, "the peer does not read its replies")),
        }
    }
}

pub(super) async fn serve(shared: Arc<Shared>, line: Line, peer: SocketAddr, seat: Seat, stop: watch::Receiver<bool>) {
    let mut connection = Connection::new(shared, line, peer, seat, stop);
    // Only running sessions are on the heap: their state is large, and idle connections are many.
    let outcome = Box::pin(connection.run()).await;
    connection.close(outcome).await;
}

struct Connection {
    shared: Arc<Shared>,
    line: Line,
    peer: SocketAddr,
    seat: Seat,
    stop: watch::Receiver<bool>,
    /// When the last frame was complete, or the present one began.
    since: Instant,
    partial: bool,
    /// For a large frame being read or answered.
    charge: Option<Charge>,
    /// Its message is charged as a whole.
    in_parts: bool,
}

impl Connection {
    fn new(shared: Arc<Shared>, line: Line, peer: SocketAddr, seat: Seat, stop: watch::Receiver<bool>) -> Self {
        Self { shared, line, peer, seat, stop, since: Instant::now(), partial: false, charge: None, in_parts: false }
    }

    async fn close(self, outcome: Result<(), End>) {
        if let Err(End::Refused(refusal)) = outcome {
            self.shared.refused(self.peer, &refusal);
            self.line.refuse(refusal.code).await;
        }
    }

    async fn run(&mut self) -> Result<(), End> {
        let deadline = Instant::now() + self.shared.limits().hello_time;
        let identified = self.hello(deadline).await?;
        match identified.purpose {
            Purpose::Allocation => self.allocation(identified, deadline).await,
            Purpose::Transfer => self.transfer(identified, deadline).await,
        }
    }

    async fn hello(&mut self, deadline: Instant) -> Result<Identified, End> {
        let payload = match self.next(deadline, None).await? {
            Next::Frame(FrameKind::Hello, payload) => payload,
            Next::Frame(FrameKind::Inquiry, payload) => {
                self.tell_network(&payload).await?;
                self.expect(FrameKind::Hello, deadline).await?
            }
            _ => return Err(Refusal::new(Code::Malformed, "a frame that is not a hello").into()),
        };
        let list = self.shared.announced().await?;
        let (answer, hello) = GatewayHello::answer(self.shared.context, &self.shared.identity, list, &payload)?;
        self.line.send(FrameKind::Answer, &answer, self.shared.limits().write_time).await?;
        let payload = self.expect(FrameKind::Identify, deadline).await?;
        Ok(hello.identified(&payload)?)
    }

    async fn tell_network(&mut self, payload: &[u8]) -> Result<(), End> {
        if payload != NetworkName::INQUIRY {
            return Err(Refusal::new(Code::Version, "an inquiry of another version").into());
        }
        let network = self.shared.desk.network_name().await?;
        Ok(self.line.send(FrameKind::Network, &network.encode(), self.shared.limits().write_time).await?)
    }

    async fn send(&mut self, session: &mut Session, request: u32, answer: &Answer) -> Result<(), End> {
        let patience = self.shared.limits().write_time;
        for text in split(answer.command(), request, Speaker::Gateway, &answer.encode()) {
            self.line.send(FrameKind::Transfer, &session.seal(&text)?, patience).await?;
        }
        Ok(())
    }

    /// Returns refusals that end the session instead of sending them.
    async fn reply(&mut self, session: &mut Session, request: u32, outcome: Result<Answer>) -> Result<(), End> {
        let charged = outcome.and_then(|answer| {
            // The chain crate bounds its answers; their memory counts against the caller.
            let length = answer.relayed_length();
            let charge = if length > 0 { Some(self.seat.charge(length)?) } else { None };
            Ok((answer, charge))
        });
        let (answer, _charge) = match charged {
            Ok(charged) => charged,
            Err(refusal) if refusal.code.ends_session() => return Err(refusal.into()),
            Err(refusal) => {
                self.shared.refused(self.peer, &refusal);
                (Answer::Refused(refusal.code), None)
            }
        };
        self.send(session, request, &answer).await?;
        // Time spent sending delays the next read.
        self.seat.pace(std::time::Instant::now(), answer.relayed_length());
        Ok(())
    }

    /// Without a transport key: few, small frames and a short life, longer only for reading the chain.
    async fn allocation(&mut self, identified: Identified, hello_deadline: Instant) -> Result<(), End> {
        let (agreed, name) = (identified.agreed(), identified.name.clone());
        self.allocation_frames(identified.session(None), agreed, name, hello_deadline).await
    }

    async fn allocation_frames(
        &mut self,
        mut session: Session,
        agreed: Agreed,
        name: ProfileName,
        hello_deadline: Instant,
    ) -> Result<(), End> {
        let patience = self.shared.limits().hello_time * ALLOCATION_PATIENCE;
        let (begun, end) = (Instant::now(), Instant::now() + self.shared.limits().visit_time);
        let (mut deadline, mut frames) = (hello_deadline, 0);
        while frames < MOST_ALLOCATION_FRAMES {
            let payload = self.expect(FrameKind::Transfer, deadline).await?;
            self.pace(payload.len()).await;
            let (counter, text) = session.open(&payload)?;
            deadline = deadline.max(begun + patience);
            let inner = Inner::from_client(&text)?;
            let message = Assembler::<()>::default().take(&inner, counter, |_| {
                Err(Refusal::new(Code::Length, "a multi-part message in an allocation session"))
            })?;
            let Some(message) = message else { continue };
            if message.command == Command::Relay {
                self.seat.visit()?;
                self.pace_relay(&message.body).await;
                deadline = end.min(Instant::now() + patience);
            } else {
                frames += 1;
            }
            let outcome = match self.count_newcomer(&message) {
                Ok(()) => self.shared.allocation_answer(&agreed, &name, &message).await,
                Err(refusal) => Err(refusal),
            };
            self.reply(&mut session, message.request, outcome).await?;
        }
        Err(Refusal::new(Code::Session, "the allocation session has ended").into())
    }

    async fn transfer(&mut self, identified: Identified, hello_deadline: Instant) -> Result<(), End> {
        let unknown = match self.shared.desk.binding(&identified.name).await {
            Ok(Some(binding)) => {
                let (agreed, name) = (identified.agreed(), identified.name.clone());
                let session = identified.session(Some(&binding.key));
                return self.transfer_frames(session, agreed, name, binding, hello_deadline).await;
            }
            Ok(None) => Refusal::new(Code::Tag, "an unknown name"),
            Err(refusal) if refusal.code == Code::Tag => refusal,
            Err(refusal) => return Err(refusal.into()),
        };
        self.refuse_unknown(identified, unknown, hello_deadline).await
    }

    async fn transfer_frames(
        &mut self,
        mut session: Session,
        agreed: Agreed,
        name: ProfileName,
        binding: Binding,
        hello_deadline: Instant,
    ) -> Result<(), End> {
        let present = name.clone();
        let Binding { account, signing, device, .. } = binding;
        let caller = Caller { name, account, signing, device, peer: self.peer };
        let mut desk = Commands { agreed, caller, binding, waiting: None, followed: BTreeSet::new() };
        let payload = self.expect(FrameKind::Transfer, hello_deadline).await?;
        let first = session.open(&payload)?;
        // The sender of this frame holds K_T: only now may it learn what the chain says of the name's device.
        if let Some(at) = self.shared.desk.recalled(&desk.binding).await? {
            return self.refuse_recalled(session, &first.1, at).await;
        }
        self.seat.authenticated();
        self.line.decoder.raise_cap();
        let presence = self.shared.tally.enter(present, desk.caller.account, self.peer);
        presence.frame(payload.len());
        let mut assembler = Assembler::default();
        self.frame(&mut session, &mut desk, &mut assembler, first.0, &first.1).await?;
        let end = Instant::now() + LONGEST_LIFE;
        loop {
            let next = self.next(end, desk.waiting.as_mut()).await;
            if session.is_spent(std::time::Instant::now()) {
                return Err(Refusal::new(Code::Session, "the session has used up its frames or its hour").into());
            }
            match next? {
                Next::Frame(FrameKind::Transfer, payload) => {
                    self.pace(payload.len()).await;
                    let (counter, text) = session.open(&payload)?;
                    presence.frame(payload.len());
                    self.frame(&mut session, &mut desk, &mut assembler, counter, &text).await?;
                }
                Next::Frame(kind, _) => {
                    return Err(Refusal::new(Code::Malformed, format_args!("a frame of kind {kind:?}")).into());
                }
                Next::Due => self.due(&mut session, &mut desk).await?,
            }
            // A sender that never pauses must not starve its own request for the feed.
            if desk.waiting.as_ref().is_some_and(Waiting::is_due) {
                self.due(&mut session, &mut desk).await?;
            }
        }
    }

    /// Answers a waiting request for the feed, if it can.
    async fn due(&mut self, session: &mut Session, commands: &mut Commands) -> Result<(), End> {
        match commands.due(&self.shared).await {
            Some((request, outcome)) => self.reply(session, request, outcome).await,
            None => Ok(()),
        }
    }

    async fn refuse_recalled(&mut self, mut session: Session, text: &[u8], at: Timestamp) -> Result<(), End> {
        let request = Inner::from_client(text)?.request;
        self.shared.refused(self.peer, &Refusal::new(Code::Recalled, format_args!("revoked at {at}")));
        self.send(&mut session, request, &Answer::Recalled(at)).await?;
        Err(End::Closed)
    }

    /// Fails like a wrong key.
    async fn refuse_unknown(&mut self, identified: Identified, why: Refusal, deadline: Instant) -> Result<(), End> {
        let key = TransportKey::generate().map_err(Refusal::internal)?;
        let mut session = identified.session(Some(&key));
        let payload = self.expect(FrameKind::Transfer, deadline).await?;
        session.open(&payload)?;
        Err(why.into())
    }

    async fn frame(
        &mut self,
        session: &mut Session,
        commands: &mut Commands,
        assembler: &mut Assembler<Charge>,
        counter: u64,
        text: &[u8],
    ) -> Result<(), End> {
        let inner = Inner::from_client(text)?;
        if inner.part != Part::Whole {
            // The whole message is charged instead.
            self.charge = None;
        }
        let message = assembler.take(&inner, counter, |bytes| self.seat.charge(bytes))?;
        self.in_parts = assembler.is_partial();
        let Some(message) = message else { return Ok(()) };
        if message.command == Command::Relay {
            self.pace_relay(&message.body).await;
        }
        let outcome = commands.answer(&self.shared, &message).await;
        let request = message.request;
        drop(message);
        match outcome.transpose() {
            Some(outcome) => self.reply(session, request, outcome).await,
            None => Ok(()),
        }
    }

    async fn expect(&mut self, wanted: FrameKind, deadline: Instant) -> Result<Vec<u8>, End> {
        match self.next(deadline, None).await? {
            Next::Frame(kind, payload) if kind == wanted => Ok(payload),
            _ => Err(Refusal::new(Code::Malformed, format_args!("a frame that is not {wanted:?}")).into()),
        }
    }

    /// Ends at `deadline`, or earlier with the limits' patience.
    async fn next(&mut self, deadline: Instant, mut waiting: Option<&mut Waiting>) -> Result<Next, End> {
        self.charge = None;
        loop {
            if let Some((kind, payload)) = self.line.arrived()? {
                self.since = Instant::now();
                self.partial = false;
                return Ok(Next::Frame(kind, payload));
            }
            let partial = self.line.decoder.is_partial();
            if partial && !self.partial {
                self.since = Instant::now();
            }
            self.partial = partial;
            let limits = self.shared.limits();
            let patience = if partial { limits.frame_time } else { limits.idle_time };
            let deadline = deadline.min(self.since + patience);
            let has_room = self.has_room();
            tokio::select! {
                filled = self.line.fill(), if has_room => filled?,
                () = sleep(ROOM), if !has_room => {}
                () = self.seat.evicted() => {
                    return Err(Refusal::new(Code::Busy, "dropped in favour of newer connections without a transport key").into());
                }
                () = due(waiting.as_deref_mut()) => return Ok(Next::Due),
                () = sleep_until(deadline) => {
                    return Err(Refusal::new(Code::TooSlow, "no complete message arrived in time").into());
                }
                () = stopped(&mut self.stop) => {
                    return Err(Refusal::new(Code::Closing, "the gateway is stopping").into());
                }
            }
        }
    }

    /// Charges a large frame to its peer before it is read; `false` while the peer has too many in flight.
    fn has_room(&mut self) -> bool {
        let charged = self.in_parts || self.charge.is_some();
        let large = self.line.decoder.announced_length().filter(|length| *length > CHARGED && !charged);
        let Some(length) = large else { return true };
        self.charge = self.seat.charge(length).ok();
        self.charge.is_some()
    }

    /// Delays a peer that sends more than it may.
    async fn pace(&self, bytes: usize) {
        self.pause(self.seat.pace(std::time::Instant::now(), bytes)).await;
    }

    async fn pause(&self, pause: Duration) {
        if pause > Duration::ZERO {
            sleep(pause.min(self.shared.limits().frame_time)).await;
        }
    }

    /// Counts transactions from a peer without a transport key.
    fn count_newcomer<C>(&self, message: &Message<C>) -> Result<()> {
        let sends = message.command == Command::Relay
            && matches!(
                Request::parse(Command::Relay, &message.body),
                Ok(Request::Relay(call)) if call.method == "eth_sendRawTransaction"
            );
        if sends { self.seat.newcomer(std::time::Instant::now()) } else { Ok(()) }
    }

    /// Delays a peer whose requests cost the chain more than they may.
    async fn pace_relay(&self, body: &[u8]) {
        let Ok(Request::Relay(call)) = Request::parse(Command::Relay, body) else { return };
        self.pause(self.seat.pace_relay(std::time::Instant::now(), weight(&call.method))).await;
    }
}

async fn due(waiting: Option<&mut Waiting>) {
    match waiting {
        Some(waiting) => waiting.due().await,
        None => std::future::pending().await,
    }
}

// Commands of a session. The order of the checks: token, signature, account, desk.

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

#[cfg(test)]
mod agreed_elsewhere {
    use super::*;

    /// Serves a session that was agreed elsewhere: tests try thousands of frames, each in its own session.
    pub async fn serve_agreed(
        (shared, line, seat, stop): (Arc<Shared>, Line, Seat, watch::Receiver<bool>),
        session: Session,
        agreed: Agreed,
        (name, binding): (ProfileName, Option<Binding>),
    ) {
        let peer = SocketAddr::from(([127, 0, 0, 1], 1));
        let mut connection = Connection::new(shared, line, peer, seat, stop);
        let deadline = Instant::now() + connection.shared.limits().hello_time;
        let outcome = match binding {
            Some(binding) => connection.transfer_frames(session, agreed, name, binding, deadline).await,
            None => connection.allocation_frames(session, agreed, name, deadline).await,
        };
        connection.close(outcome).await;
    }
}
