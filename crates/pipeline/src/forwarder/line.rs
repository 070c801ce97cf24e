//! The outbox, and the line to the gateway: connects at the first address that answers, sends, and follows the feed.
//! From a later address it goes back as soon as the gateway answers at an earlier one.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use std::{collections::HashSet, convert::Infallible, path::PathBuf};

use tokio::sync::{Notify, watch};
use tokio::task::{JoinSet, block_in_place};
use tokio::time::sleep;

use super::{CopyKeeping, Errand, ForwardError, Gate, LONGEST_RETRY, Link, Pace, Proofs, is_about_a_record};
use crate::gateway::{Client, GatewayError, Upload};
use crate::model::{Address, Digest, RecordState, Timestamp, clean, counted};
use crate::store::{KeptReceipt, RecordQuery};
use crate::{PipelineError, Plant, Result, crypto::random_bytes, store::files::free_bytes};

/// How long a gateway with several addresses may be silent before it is polled.
const SILENCE: Duration = Duration::from_secs(3);
/// The longest pause between two looks at an earlier address.
const LONGEST_LOOK: Duration = Duration::from_secs(300);

pub(super) struct Line<'a> {
    pub outbox: &'a mut Outbox,
    gate: Gate,
    link: watch::Sender<Link>,
    errand: &'a mut Option<Box<dyn Errand>>,
    pub(super) proofs: Proofs,
    checked: Option<Instant>,
    /// Whether the present session achieved anything.
    pub moved: bool,
    /// When the gateway last answered.
    heard: Instant,
    /// The pause before an earlier address is tried. It doubles while that answers and does not lead to the gateway.
    look_after: Duration,
}

impl<'a> Line<'a> {
    pub fn new(
        (outbox, owner): (&'a mut Outbox, Address),
        gate: Gate,
        link: watch::Sender<Link>,
        errand: &'a mut Option<Box<dyn Errand>>,
    ) -> Self {
        Self {
            look_after: outbox.pace.longest_pause,
            proofs: block_in_place(|| Proofs::load(&outbox.plant, owner)),
            outbox,
            gate,
            link,
            errand,
            checked: None,
            moved: false,
            heard: Instant::now(),
        }
    }

    pub async fn run(&mut self, stored: &Notify) -> Infallible {
        let mut pauses = Pauses::of(self.outbox.pace);
        loop {
            self.moved = false;
            match self.session(stored).await {
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

    fn tell(&self, error: &ForwardError) {
        let link = error.link(self.proofs.owner);
        let (urgent, text) = match &link {
            Link::Refused(text) if matches!(error, ForwardError::Gateway(GatewayError::Recalled(_))) => {
                (true, text.clone())
            }
            Link::Refused(text) => (
                true,
                format!(
                    "records wait in the outbox: {text}; if the owner revoked this robot or its authorisation has \
                     ended, the owner must enrol it again"
                ),
            ),
            Link::Connecting | Link::Up | Link::InPlace(_) | Link::Away(_) => {
                (false, format!("records wait in the outbox until the gateway is back: {error}"))
            }
        };
        self.link.send_replace(link);
        self.outbox.plant.observer.alert(urgent, text);
    }

    /// Ends when the connection breaks, the session is used up, or the gateway answers at an earlier address.
    async fn session(&mut self, stored: &Notify) -> Result<(), ForwardError> {
        let mut client = Client::connect(&self.gate.endpoint, &mut self.gate.trust, &self.gate.credentials).await?;
        block_in_place(|| self.gate.trust.save(&self.gate.trust_file)).map_err(PipelineError::from)?;
        self.heard = Instant::now();
        let up = self.up(&client);
        let mut earlier = self.earlier(client.address());
        if let Some(errand) = self.errand {
            errand.begin(&mut client).await?;
        }
        while !client.is_spent() && earlier.try_join_next().is_none() {
            let waiting = stored.notified();
            tokio::pin!(waiting);
            waiting.as_mut().enable();
            if self.work(&mut client, &up).await? == 0 {
                // Either way: look again.
                tokio::select! {
                    () = waiting => {}
                    () = sleep(self.outbox.pace.check) => {}
                }
            }
        }
        Ok(())
    }

    /// Reports why the addresses before this one are not used.
    fn up(&self, client: &Client) -> Link {
        let Some((first, _)) = client.passed_over().first() else { return Link::Up };
        let address = clean(client.address(), 255);
        for (other, error) in client.passed_over() {
            let text = format!("the gateway cannot be used at {other}, records go to {address}: {error}");
            self.outbox.plant.observer.alert(false, text);
        }
        Link::InPlace(format!("connected to {address} instead of {first}"))
    }

    /// A task that ends as soon as the gateway answers at an address before this one; none at the first.
    fn earlier(&mut self, address: &str) -> JoinSet<()> {
        let before = self.gate.endpoint.addresses.iter().take_while(|other| *other != address).cloned();
        let (before, patience, pause) = (before.collect::<Vec<_>>(), self.gate.endpoint.patience, self.look_after);
        let mut earlier = JoinSet::new();
        if before.is_empty() {
            self.look_after = self.outbox.pace.longest_pause;
            return earlier;
        }
        self.look_after = (pause * 2).min(LONGEST_LOOK);
        let every = self.outbox.pace.longest_pause;
        earlier.spawn(async move {
            sleep(pause).await;
            while Client::inquire(&before, patience).await.is_err() {
                sleep(every).await;
            }
        });
        earlier
    }

    async fn work(&mut self, client: &mut Client, up: &Link) -> Result<usize, ForwardError> {
        if let Some(errand) = self.errand {
            errand.run(client).await?;
        }
        self.outbox.retry_refused();
        let sent = self.upload(client).await?;
        self.link.send_if_modified(|link| {
            let changed = *link != *up;
            link.clone_from(up);
            changed
        });
        self.outbox.keep_tidy()?;
        let mut heard = sent > 0;
        if self.checked.is_none_or(|at| at.elapsed() >= self.outbox.pace.check) {
            heard |= self.check(client).await?;
            self.checked = Some(Instant::now());
        }
        let is_silent = self.heard.elapsed() >= SILENCE && self.gate.endpoint.addresses.len() > 1;
        if !heard && is_silent {
            client.ping().await?;
        }
        if heard || is_silent {
            self.heard = Instant::now();
        }
        Ok(sent)
    }

    /// Returns how many records the gateway took over, or refused for their own sake.
    async fn upload(&mut self, client: &mut Client) -> Result<usize, ForwardError> {
        let window = block_in_place(|| self.outbox.window())?;
        let (digests, uploads): (Vec<Digest>, Vec<Upload>) = window.into_iter().unzip();
        if uploads.is_empty() {
            return Ok(0);
        }
        match client.upload(uploads).await {
            Ok(receipt) => {
                let kept = KeptReceipt { time: receipt.time, digests: receipt.digests, signature: receipt.signature };
                self.outbox.plant.ledger.forwarding.accept(kept)?;
                self.moved = true;
                self.outbox.plant.observer.records_changed();
            }
            Err(error) if is_about_a_record(&error) => self.outbox.set_aside(&digests, &error),
            Err(error) => return Err(error.into()),
        }
        Ok(digests.len())
    }
}

/// Each pause after a failure is twice as long as the one before, up to the longest.
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

/// Between half of `pause` and all of it, by a random `share` of 255: robots that lost their gateway together do not
/// come back together.
fn shortened(pause: Duration, share: u8) -> Duration {
    let half = pause / 2;
    half + half.mul_f64(f64::from(share) / 255.0)
}

/// The most records in one upload.
const WINDOW: usize = 256;
/// The most bytes in one upload, unless a single record is larger.
const WINDOW_BYTES: usize = 4 * 1024 * 1024;
/// Copies given up together.
const PAGE: usize = 256;

pub(super) struct Outbox {
    pub plant: Plant,
    home: PathBuf,
    pub keeping: CopyKeeping,
    pub refused: Arc<Mutex<HashSet<Digest>>>,
    pub pace: Pace,
    /// Since when the first refused record has been waiting for another attempt.
    aside_since: Option<Instant>,
    /// How many of the next uploads are sent one by one, because one of them is refused.
    singly: usize,
    /// The pause before refused records are sent again; it doubles, from the pace's on.
    retry: Option<Duration>,
    tidied: Option<Instant>,
}

impl Outbox {
    pub fn new(plant: Plant, home: PathBuf) -> Self {
        let (keeping, pace, refused) = (CopyKeeping::default(), Pace::default(), Arc::default());
        Self { plant, home, keeping, refused, pace, aside_since: None, singly: 0, retry: None, tidied: None }
    }

    fn refused(&self) -> MutexGuard<'_, HashSet<Digest>> {
        self.refused.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One of these records is refused: if it is the only one it is set aside, otherwise it is searched for.
    pub fn set_aside(&mut self, digests: &[Digest], error: &GatewayError) {
        let [digest] = digests else {
            self.singly = digests.len();
            return;
        };
        self.refused().insert(*digest);
        self.aside_since.get_or_insert_with(Instant::now);
        self.plant.observer.alert(true, format!("record {digest} stays in the outbox: {error}"));
    }

    /// Sends refused records again after their pause: gateways get repaired, and settings change.
    pub fn retry_refused(&mut self) {
        let pause = self.retry.unwrap_or(self.pace.retry);
        if self.aside_since.is_some_and(|since| since.elapsed() >= pause) {
            self.refused().clear();
            self.aside_since = None;
            self.retry = Some((pause * 2).min(LONGEST_RETRY));
        }
    }

    /// The next records to send, their bytes compared with their digests.
    pub fn window(&mut self) -> Result<Vec<(Digest, Upload)>> {
        let refused = self.refused().clone();
        let most = if self.singly > 0 { 1 } else { WINDOW };
        self.singly = self.singly.saturating_sub(1);
        let limit = most + refused.len();
        let query = RecordQuery { state: Some(RecordState::Stored), limit, ..RecordQuery::default() };
        let rows = self.plant.ledger.records.list(&query)?.rows;
        let (mut window, mut bytes, mut spoilt) = (Vec::new(), 0, Vec::new());
        for row in rows.into_iter().filter(|row| !refused.contains(&row.digest)).take(most) {
            let blob = self.plant.ciphertext.get(row.digest)?;
            let Some(blob) = blob.filter(|blob| self.plant.provider.sm3(&[blob]) == row.digest.0) else {
                spoilt.push(row.digest);
                continue;
            };
            if !window.is_empty() && bytes + blob.len() > WINDOW_BYTES {
                break;
            }
            bytes += blob.len();
            window.push((row.digest, Upload { signature: row.signature, blob }));
        }
        if !spoilt.is_empty() {
            self.plant.ledger.records.advance(&spoilt, RecordState::Stored, RecordState::Tampered)?;
            self.plant.observer.tampered(&spoilt);
            let records = counted(spoilt.len() as u64, "record");
            let text = format!("damaged or missing in the outbox, and not sent: {records}");
            self.plant.observer.alert(true, text);
        }
        Ok(window)
    }

    pub fn keep_tidy(&mut self) -> Result<()> {
        if self.tidied.is_none_or(|at| at.elapsed() >= self.pace.tidy) {
            block_in_place(|| self.tidy())?;
            self.tidied = Some(Instant::now());
        }
        Ok(())
    }

    pub fn tidy(&self) -> Result<()> {
        let time = u64::try_from(self.keeping.time.as_nanos()).unwrap_or(u64::MAX);
        let due = Timestamp(Timestamp::now().0.saturating_sub(time));
        loop {
            let old = self.plant.ledger.forwarding.proven_before(due, PAGE)?;
            if old.is_empty() {
                break;
            }
            self.give_up(&old)?;
        }
        // A little more than the reserve, so that records are still accepted.
        let wanted = self.keeping.reserve.saturating_add(self.keeping.reserve / 2);
        if wanted > 0 && free_bytes(&self.home)? < wanted {
            let oldest = self.plant.ledger.forwarding.proven_before(Timestamp(i64::MAX.unsigned_abs()), PAGE)?;
            if !oldest.is_empty() {
                self.give_up(&oldest)?;
                let text = format!(
                    "deleted early, because the disk is nearly full: {}",
                    counted(oldest.len() as u64, "proven record")
                );
                self.plant.observer.alert(false, text);
            }
        }
        Ok(())
    }

    fn give_up(&self, digests: &[Digest]) -> Result<()> {
        // Deleted first: after an interruption it is deleted again.
        self.plant.ciphertext.discard(digests)?;
        Ok(self.plant.ledger.forwarding.proven_gone(digests)?)
    }
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
    fn a_silent_address_is_left_within_ten_seconds() {
        // It is asked whether it is there, and then waited for; nothing else comes before the next one's turn.
        assert!(SILENCE + PATIENCE_OF_SEVERAL < Duration::from_secs(10));
    }
}
