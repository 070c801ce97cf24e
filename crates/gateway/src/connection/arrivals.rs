//! The next frame in time, charged and paced, or news for a waiting request.

use std::time::Duration;

use tokio::time::{Instant, sleep, sleep_until};

use super::{Connection, End, Waiting};
use crate::error::{Code, Refusal, Result};
use crate::frame::Message;
use crate::gateway::command::{Command, Request};
use crate::gateway::frame::FrameKind;
use crate::gateway::server::stopped;
use crate::model::relay::weight;

/// Longer frames are charged before they are read; bytes.
const CHARGED: usize = 16 * 1024;
/// Between attempts to get memory for a frame.
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

    /// Ends at `deadline`, or earlier with the limits' patience.
    pub(super) async fn next(&mut self, deadline: Instant, mut waiting: Option<&mut Waiting>) -> Result<Next, End> {
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
    pub(super) async fn pace(&self, bytes: usize) {
        self.pause(self.seat.pace(std::time::Instant::now(), bytes)).await;
    }

    async fn pause(&self, pause: Duration) {
        if pause > Duration::ZERO {
            sleep(pause.min(self.shared.limits().frame_time)).await;
        }
    }

    /// Counts transactions from a peer without a transport key.
    pub(super) fn count_newcomer<C>(&self, message: &Message<C>) -> Result<()> {
        let sends = message.command == Command::Relay
            && matches!(
                Request::parse(Command::Relay, &message.body),
                Ok(Request::Relay(call)) if call.method == "eth_sendRawTransaction"
            );
        if sends { self.seat.newcomer(std::time::Instant::now()) } else { Ok(()) }
    }

    /// Delays a peer whose requests cost the chain more than they may.
    pub(super) async fn pace_relay(&self, body: &[u8]) {
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
