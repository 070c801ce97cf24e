//! The subscriptions of a mirror's second connection, and the owners whose records the gateway does not give to this reader
//! yet: the chain here knows a grant a moment before the gateway does, or before it is deep enough for it.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;

use super::SILENCE;
use crate::gateway::{Client, Code, Entry, Fetched, GatewayError, Query, Selection};
use crate::model::{Address, Timestamp};

/// The first pause before the gateway is asked again whether it gives an owner's records, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));

/// A reader is told that he waits once the pauses are so long: some four seconds after the first refusal.
const LATE: Duration = Duration::from_secs(4);

/// A record of a subscription with its entry, or why there are no more.
pub(super) type Fed = Result<(Entry, Fetched), GatewayError>;

/// Owners whose records the gateway did not give when it was asked.
#[derive(Debug)]
pub(super) struct Refused {
    owners: BTreeSet<Address>,
    again: Instant,
    pause: Duration,
    said: bool,
}

impl Refused {
    /// As of now.
    pub fn new(owners: BTreeSet<Address>, now: Instant) -> Self {
        Self { owners, again: now + PAUSES.0, pause: PAUSES.0, said: false }
    }

    /// The owners, once, if it takes longer than a gateway needs to see a block: it may want a grant to be deeper in the chain.
    pub fn is_late(&mut self) -> Option<&BTreeSet<Address>> {
        let late = !self.owners.is_empty() && self.pause >= LATE && !std::mem::replace(&mut self.said, true);
        late.then_some(&self.owners)
    }

    /// Asks again if it is time to; `true` = the gateway gives the records of one of them now.
    ///
    /// # Errors
    /// [`GatewayError`], but for the refusal.
    pub async fn is_given(&mut self, client: &mut Client, now: Instant) -> Result<bool, GatewayError> {
        if self.owners.is_empty() || now < self.again {
            return Ok(false);
        }
        for owner in &self.owners {
            let selection = Selection::all(*owner);
            let query = Query { selection, from: Timestamp(0), until: Timestamp(u64::MAX), cursor: 0, limit: 1 };
            match client.query(&query).await {
                Ok(_) => return Ok(true),
                Err(GatewayError::Refused(Code::NotAuthorised)) => {}
                Err(error) => return Err(error),
            }
        }
        self.pause = (self.pause * 2).min(PAUSES.1);
        self.again = now + self.pause;
        Ok(false)
    }
}

/// Subscribes to each owner's records; returns those whose records the gateway does not give, too.
///
/// # Errors
/// [`GatewayError`], but for that refusal.
pub(super) async fn subscribe(
    mut client: Client,
    owners: &[Address],
) -> Result<(Client, BTreeSet<Address>), GatewayError> {
    let mut refused = BTreeSet::new();
    for owner in owners {
        match client.subscribe(&Selection::all(*owner)).await {
            Ok(_) => {}
            Err(GatewayError::Refused(Code::NotAuthorised)) => {
                refused.insert(*owner);
            }
            Err(error) => return Err(error),
        }
    }
    Ok((client, refused))
}

/// Passes on what comes, until the connection or a subscription ends.
pub(super) async fn follow(mut client: Client, feed: mpsc::Sender<Fed>) {
    loop {
        let next = match client.next_event(SILENCE).await {
            Ok((_, entry, record)) => Ok((entry, record)),
            Err(GatewayError::TimedOut) => match client.ping().await {
                Ok(_) if !client.is_spent() => continue,
                Ok(_) => Err(GatewayError::Closed),
                Err(error) => Err(error),
            },
            Err(error) => Err(error),
        };
        let ended = next.is_err();
        if feed.send(next).await.is_err() || ended {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_is_told_once_and_not_of_a_moment() {
        let mut none = Refused::new(BTreeSet::new(), Instant::now());
        none.pause = PAUSES.1;
        assert_eq!(none.is_late(), None);
        let owners = BTreeSet::from([Address([1; 20])]);
        let mut refused = Refused::new(owners.clone(), Instant::now());
        for pause in [500, 1_000, 2_000] {
            refused.pause = Duration::from_millis(pause);
            assert_eq!(refused.is_late(), None, "{pause}");
        }
        refused.pause = LATE;
        assert_eq!(refused.is_late(), Some(&owners));
        assert_eq!(refused.is_late(), None, "once");
    }
}
