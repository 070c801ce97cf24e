//! Input of a connection: the next frame, in time, charged and paced, or news for a request that waits.

use std::time::Duration;

use tokio::time::{Instant, sleep, sleep_until};

use super::{Connection, End, Waiting};
use crate::error::{Code, Refusal};
use crate::frame::Message;
use crate::gateway::command::{Command, Request};
use crate::gateway::frame::FrameKind;
use crate::gateway::server::stopped;
use crate::model::relay::weight;

/// Frames that announce a greater length are charged before they are read, bytes.
const CHARGED: usize = 16 * 1024;
/// How often a frame waiting for memory is tried again.
const ROOM: Duration = Duration::from_millis(50);

pub(super) enum Next {
    Frame(FrameKind, Vec<u8>),
    /// A request for the feed may have an answer.
    Due,
}

impl Connection {
    pub(super) async fn expect(&mut self, wanted: FrameKind, deadline: Instant) -> Result<Vec<u8>, End> {
        match self.next(deadline, None).await? {
            Next::Frame(kind, payload) if kind == wanted => Ok(payload),
            _ => Err(Refusal::new(Code::Malformed, format_args!("a frame that is not {wanted:?}")).into()),
        }
    }

    /// The next frame, or the moment to look again at a request that waits, until `deadline` or until the limits' patience ends.
    pub(super) async fn next(&mut self, deadline: Instant, mut waiting: Option<&mut Waiting>) -> Result<Next, End> {
        self.charge = None;
        loop {
            if let Some((kind, payload)) = self.line.arrived()? {
                self.since = Instant::now();
                self.partial = false;
                return Ok(Next::Frame(kind, payload));
            }
            let partial = self.line.is_partial();
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

    /// Whether the announced frame may be read: a large frame is charged to its peer first, and waits if the peer has
    /// too many in flight.
    fn has_room(&mut self) -> bool {
        let charged = self.in_parts || self.charge.is_some();
        let large = self.line.announced().filter(|length| *length > CHARGED && !charged);
        let Some(length) = large else { return true };
        self.charge = self.seat.charge(length).ok();
        self.charge.is_some()
    }

    /// Counts what arrived, and waits if the peer sends more than it may.
    pub(super) async fn pace(&self, bytes: usize) {
        let pause = self.seat.pace(std::time::Instant::now(), bytes);
        if pause > Duration::ZERO {
            sleep(pause.min(self.shared.limits().frame_time)).await;
        }
    }

    /// Counts what a peer without a transport key sends to the chain.
    pub(super) fn count_newcomer<C>(&self, message: &Message<C>) -> Result<(), Refusal> {
        let sends = message.command == Command::Relay
            && matches!(
                Request::parse(Command::Relay, &message.body),
                Ok(Request::Relay(call)) if call.method == "eth_sendRawTransaction"
            );
        if sends { self.seat.newcomer(std::time::Instant::now()) } else { Ok(()) }
    }

    /// Counts a request to the chain by its cost there, and waits if the peer asks more than it may.
    pub(super) async fn pace_relay(&self, body: &[u8]) {
        let Ok(Request::Relay(call)) = Request::parse(Command::Relay, body) else { return };
        let pause = self.seat.pace_relay(std::time::Instant::now(), weight(&call.method));
        if pause > Duration::ZERO {
            sleep(pause.min(self.shared.limits().frame_time)).await;
        }
    }
}

async fn due(waiting: Option<&mut Waiting>) {
    match waiting {
        Some(waiting) => waiting.due().await,
        None => std::future::pending().await,
    }
}
