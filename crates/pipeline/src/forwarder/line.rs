//! The line to one gateway: connects when this gateway is wanted, sends while it is on duty, and asks how the records
//! stand that it signed for. Another gateway is wanted when those before it do not answer, while it has records that
//! are not proven yet, and for records that another one does not prove.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::Notify;
use tokio::task::block_in_place;
use tokio::time::sleep;

use crate::crypto::random_bytes;
use crate::gateway::{Client, GatewayError, Upload};
use crate::model::{Digest, Timestamp, clean};
use crate::pipeline::PipelineError;
use crate::store::KeptReceipt;

use super::outbox::Outbox;
use super::roster::{Condition, Roster};
use super::{ForwardError, Gate, Link, Pace, is_about_a_record};

/// How long one of several gateways may be silent before it is asked whether it is there.
const SILENCE: Duration = Duration::from_secs(3);

pub(super) struct Line {
    pub outbox: Arc<Outbox>,
    pub roster: Arc<Roster>,
    pub place: usize,
    pub gate: Gate,
    /// Rings when records wait.
    ring: Arc<Notify>,
    /// Where the next check of standings begins.
    pub cursor: Option<i64>,
    checked: Option<Instant>,
    /// Whether the present session achieved anything.
    pub moved: bool,
    /// Whether the present session has begun its errand.
    on_duty: bool,
    /// When the gateway last answered.
    heard: Instant,
    /// When it was last looked whether records of other gateways wait for this one, and whether any did.
    pub overdue: Option<(Instant, bool)>,
    /// How many of them are sent one by one, because one is refused.
    pub singly: usize,
    /// Records of which this gateway says that it holds other bytes, told once.
    pub disputed: HashSet<Digest>,
}

impl Line {
    pub fn new(outbox: Arc<Outbox>, roster: Arc<Roster>, ring: Arc<Notify>, place: usize, gate: Gate) -> Self {
        Self {
            outbox,
            roster,
            place,
            gate,
            ring,
            cursor: None,
            checked: None,
            moved: false,
            on_duty: false,
            heard: Instant::now(),
            overdue: None,
            singly: 0,
            disputed: HashSet::new(),
        }
    }

    /// Works until it is dropped. Can be cancelled at any point.
    pub async fn run(mut self) {
        let mut pauses = Pauses::of(self.outbox.pace);
        loop {
            self.rest().await;
            self.moved = false;
            match self.session().await {
                Ok(()) => pauses.begin_again(),
                Err(error) => self.tell(&error),
            }
            if self.moved {
                pauses.begin_again();
            }
            // Without random bytes the whole pause does.
            let share = random_bytes::<1>().map_or(u8::MAX, |[byte]| byte);
            sleep(shortened(pauses.next(), share)).await;
        }
    }

    /// Waits until this gateway is wanted. One that was away counts as there again after a while: nobody knows better.
    async fn rest(&mut self) {
        let (mut conditions, begun) = (self.roster.follow(), Instant::now());
        while !self.is_wanted() {
            if !self.roster.is_away(self.place) || begun.elapsed() >= self.outbox.pace.longest_pause * 2 {
                self.roster.set(self.place, Condition::Resting);
            }
            tokio::select! {
                // An error cannot be: the sender is in the roster.
                _ = conditions.changed() => {}
                () = sleep(self.outbox.pace.check) => {}
            }
        }
    }

    fn is_wanted(&mut self) -> bool {
        if self.roster.is_next_in_line(self.place) {
            return true;
        }
        let (ledger, gateway) = (&self.outbox.plant.ledger, self.gate.fingerprint);
        // If the ledger cannot be read, whoever writes to it says so.
        block_in_place(|| ledger.is_placed_at(gateway)).unwrap_or(false) || self.has_overdue()
    }

    fn tell(&self, error: &ForwardError) {
        let link = error.link();
        let condition = match &link {
            Link::Refused(text) => Condition::Refused(text.clone()),
            Link::Connecting | Link::Up | Link::InPlace(_) | Link::Away(_) => Condition::Away(error.to_string()),
        };
        self.roster.set(self.place, condition);
        let urgent = matches!(link, Link::Refused(_));
        let address = clean(&self.gate.endpoint.address, 255);
        let text = match (&link, self.roster.down()) {
            (_, None) => format!("the gateway {address} accepts no records; another one does: {error}"),
            (Link::Refused(text), _) => format!(
                "records wait in the outbox: {text}; if the owner recalled this robot or its loan has ended, the owner must enrol it again"
            ),
            _ => format!("records wait in the outbox until the gateway is back: {error}"),
        };
        if let Some(link) = self.roster.down() {
            self.outbox.link.send_replace(link);
        }
        self.outbox.plant.observer.alert(urgent, text);
    }

    /// One session: connects, then sends and checks until the connection breaks, the session is used up or this gateway
    /// is no longer wanted.
    async fn session(&mut self) -> Result<(), ForwardError> {
        let mut client = Client::connect(&self.gate.endpoint, &mut self.gate.trust, &self.gate.credentials).await?;
        block_in_place(|| self.gate.trust.save(&self.gate.trust_file)).map_err(PipelineError::from)?;
        (self.on_duty, self.heard) = (false, Instant::now());
        self.roster.set(self.place, Condition::Up);
        let (ring, mut conditions) = (Arc::clone(&self.ring), self.roster.follow());
        while !client.is_spent() {
            let ringing = ring.notified();
            tokio::pin!(ringing);
            ringing.as_mut().enable();
            let sent = self.work(&mut client).await?;
            if sent == 0 {
                if !self.is_wanted() {
                    return Ok(());
                }
                // All outcomes mean: look again.
                tokio::select! {
                    () = ringing => {}
                    _ = conditions.changed() => {}
                    () = sleep(self.outbox.pace.check) => {}
                }
            }
        }
        Ok(())
    }

    /// Does what is due; returns how many records were sent.
    async fn work(&mut self, client: &mut Client) -> Result<usize, ForwardError> {
        let mut sent = 0;
        if self.roster.is_on_duty(self.place) {
            sent += self.serve(client).await?;
        } else {
            self.on_duty = false;
        }
        let pace = self.outbox.pace;
        if self.checked.is_none_or(|at| at.elapsed() >= pace.check) {
            if self.check(client).await? {
                self.heard = Instant::now();
            }
            self.checked = Some(Instant::now());
        }
        sent += self.resend(client).await?;
        if sent > 0 {
            self.heard = Instant::now();
        }
        if self.roster.len() > 1 && self.heard.elapsed() >= SILENCE {
            client.ping().await?;
            self.heard = Instant::now();
        }
        Ok(sent)
    }

    /// On duty: the errand, then the oldest waiting records.
    async fn serve(&mut self, client: &mut Client) -> Result<usize, ForwardError> {
        if let Some(errand) = self.outbox.errand.lock().await.as_mut() {
            if !self.on_duty {
                errand.begin(client).await?;
            }
            errand.run(client).await?;
        }
        self.on_duty = true;
        self.outbox.retry_refused();
        let sent = self.upload(client).await?;
        let up = self.roster.up(self.place);
        self.outbox.link.send_if_modified(|link| {
            let changed = *link != up;
            *link = up;
            changed
        });
        self.outbox.keep_tidy()?;
        Ok(sent)
    }

    /// Sends the oldest waiting records; returns how many the gateway took over, or refused for their own sake.
    async fn upload(&mut self, client: &mut Client) -> Result<usize, ForwardError> {
        let window = block_in_place(|| self.outbox.window())?;
        let (digests, uploads): (Vec<Digest>, Vec<Upload>) = window.into_iter().unzip();
        if uploads.is_empty() {
            return Ok(0);
        }
        if let Some(refused) = self.send(client, uploads).await? {
            self.outbox.set_aside(&digests, &refused);
        }
        Ok(digests.len())
    }

    /// Sends records and keeps the receipt; returns why, if they are refused for the sake of one of them.
    pub async fn send(
        &mut self,
        client: &mut Client,
        uploads: Vec<Upload>,
    ) -> Result<Option<GatewayError>, ForwardError> {
        match client.upload(uploads).await {
            Ok(receipt) => {
                let kept = KeptReceipt { time: receipt.time, digests: receipt.digests, signature: receipt.signature };
                let (ledger, gateway) = (&self.outbox.plant.ledger, self.gate.fingerprint);
                block_in_place(|| ledger.accept(gateway, Timestamp::now(), kept))?;
                self.moved = true;
                self.outbox.plant.observer.records_changed();
                Ok(None)
            }
            Err(error) if is_about_a_record(&error) => Ok(Some(error)),
            Err(error) => Err(error.into()),
        }
    }
}

/// The pauses after failures: each is twice as long as the one before, up to the longest.
struct Pauses {
    pace: Pace,
    next: Duration,
}

impl Pauses {
    fn of(pace: Pace) -> Self {
        Self { pace, next: pace.first_pause }
    }

    fn begin_again(&mut self) {
        self.next = self.pace.first_pause;
    }

    fn next(&mut self) -> Duration {
        let pause = self.next;
        self.next = (pause * 2).min(self.pace.longest_pause);
        pause
    }
}

/// A pause between half of this and all of it, by a random `share` of 255: robots that lost a gateway together do not come back
/// together.
fn shortened(pause: Duration, share: u8) -> Duration {
    let half = pause / 2;
    half + half.mul_f64(f64::from(share) / 255.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::forwarder::PATIENCE_OF_SEVERAL;

    #[test]
    fn pauses_double_up_to_a_longest_and_begin_again() {
        let mut pauses = Pauses::of(Pace::default());
        let told: Vec<u128> = std::iter::repeat_with(|| pauses.next().as_millis()).take(8).collect();
        assert_eq!(told, [250, 500, 1000, 2000, 4000, 5000, 5000, 5000]);
        pauses.begin_again();
        assert_eq!(pauses.next(), Duration::from_millis(250));
    }

    #[test]
    fn a_pause_is_shortened_at_random_to_between_half_of_it_and_all_of_it() {
        let pause = Duration::from_secs(4);
        let of = |share| shortened(pause, share);
        assert_eq!((of(0), of(255)), (pause / 2, pause));
        assert!((0..255).all(|share| of(share) < of(share + 1)), "each share is another pause");
        assert!(shortened(Duration::ZERO, 255).is_zero());
    }

    #[test]
    fn a_silent_gateway_is_left_within_ten_seconds() {
        // It is asked whether it is there, and then waited for; nothing else comes before the next one's turn.
        assert!(SILENCE + PATIENCE_OF_SEVERAL < Duration::from_secs(10));
    }
}
