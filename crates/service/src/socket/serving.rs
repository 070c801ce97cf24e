//! The site's side: the joiner, as named by the kernel, is judged before anything is read; then each line is answered.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde::Deserialize;
use tokio::io::{AsyncWriteExt as _, BufReader};
use tokio::net::unix::OwnedReadHalf;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{Semaphore, mpsc, oneshot};
use zeroize::Zeroize as _;

use super::{BINDING, FromSite, Greeting, LONGEST_LINE, Numbered, QUEUE, bind, line_of, read_line, write_lines};
use crate::model::{ErrorKind, ProfileName};
use crate::service::client::{Call, site_gone};
use crate::service::command::{Kind, Request};
use crate::service::failure::refused;
use crate::service::reply::{Failure, Reply, Result};
use crate::service::site::{Asker, Heard, Site, joiner};

/// Longest line from an operator, bytes.
const LONGEST_OF_OPERATOR: usize = 1024 * 1024;
/// Unanswered requests per connection.
const MOST_WAITING: usize = 256;
/// Connections of one operator.
const MOST_CONNECTIONS: usize = 16;
/// Time for the last lines to a joiner.
const FAREWELL: Duration = Duration::from_secs(5);

pub fn listen(site: &Arc<Site>) -> Result<()> {
    let path = site.home().socket();
    let unusable = |error: std::io::Error| {
        Failure::new(ErrorKind::Home, format!("the socket {} cannot be created: {error}", path.display()))
    };
    match std::fs::remove_file(&path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(unusable(error)),
        _ => {}
    }
    let listener = Arc::new(bind(&path, 0o600).map_err(unusable)?);
    site.supervise("socket", move |site| {
        let listener = Arc::clone(&listener);
        async move { accept(&site, &listener, &Door::Home).await }
    });
    Ok(())
}

pub(crate) async fn accept_operators(site: &Arc<Site>, listener: &UnixListener) {
    accept(site, listener, &Door::Operators(Arc::default())).await;
}

#[derive(Clone)]
enum Door {
    /// The home's own socket: its owner alone.
    Home,
    /// The operators' socket: users with rights.
    Operators(Arc<Crowd>),
}

/// Connections per user.
type Crowd = Mutex<HashMap<u32, usize>>;

struct Place {
    crowd: Arc<Crowd>,
    uid: u32,
}

impl Place {
    /// `None` if the user has the most allowed.
    fn take(crowd: &Arc<Crowd>, uid: u32) -> Option<Self> {
        let mut users = crowd.lock().unwrap_or_else(PoisonError::into_inner);
        let connections = users.entry(uid).or_default();
        if *connections >= MOST_CONNECTIONS {
            return None;
        }
        *connections += 1;
        Some(Self { crowd: Arc::clone(crowd), uid })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut users = self.crowd.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(connections) = users.get_mut(&self.uid) {
            *connections -= 1;
            if *connections == 0 {
                users.remove(&self.uid);
            }
        }
    }
}

async fn accept(site: &Arc<Site>, listener: &UnixListener, door: &Door) {
    loop {
        tokio::select! {
            joined = listener.accept() => {
                if let Ok((stream, _)) = joined {
                    tokio::spawn(receive(Arc::clone(site), stream, door.clone()));
                } else {
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            }
            () = site.stopped() => return,
        }
    }
}

async fn receive(site: Arc<Site>, mut stream: UnixStream, door: Door) {
    // A peer that has gone needs no answer.
    let Ok(peer) = stream.peer_cred() else { return };
    match judge(&site, peer.uid(), &door).await {
        Ok((asker, _place)) => serve_joiner(site, stream, asker).await,
        Err(refusal) => {
            if let Some(line) = line_of(&FromSite::Refused(refusal)) {
                drop(tokio::time::timeout(FAREWELL, stream.write_all(&line)).await);
            }
        }
    }
}

async fn judge(site: &Arc<Site>, uid: u32, door: &Door) -> Result<(Asker, Option<Place>)> {
    let Door::Operators(crowd) = door else {
        return site.check_owner(uid).map(|()| (Asker::Owner, None));
    };
    let place = Place::take(crowd, uid).ok_or_else(|| {
        refused(format!("user {uid} has {MOST_CONNECTIONS} connections to this site already; close one of them first"))
    })?;
    Ok((Asker::Operator(site.admit_operator(uid).await?), Some(place)))
}

async fn serve_joiner(site: Arc<Site>, stream: UnixStream, asker: Asker) {
    let (reader, writer) = stream.into_split();
    let (lines, queue) = mpsc::channel(QUEUE);
    let mut writing = tokio::spawn(write_lines(writer, queue));
    let greeting = line_of(&FromSite::Greeting(greeting(&site, &asker))).unwrap_or_default();
    if lines.send(greeting).await.is_err() {
        return;
    }
    let claims = joiner(asker.clone());
    let events = lines.clone();
    let telling = tokio::spawn(Arc::clone(&site).tell_events(Arc::clone(&claims), move |what| {
        let line = match what {
            Heard::Event(event) => line_of(&FromSite::Event(event)),
            Heard::Ended(refusal) => line_of(&FromSite::Ended(refusal)),
        };
        // A joiner that reads too slowly misses events.
        !matches!(line.map(|line| events.try_send(line)), Some(Err(mpsc::error::TrySendError::Closed(_))))
    }));
    let (calls, receiver) = mpsc::unbounded_channel();
    tokio::spawn(Arc::clone(&site).serve(receiver, claims));
    Joiner { site, asker, calls, lines }.answer_lines(BufReader::new(reader)).await;
    // A task that sends nothing would never notice that the joiner has gone.
    telling.abort();
    if tokio::time::timeout(FAREWELL, &mut writing).await.is_err() {
        writing.abort();
    }
}

/// An operator's line by its tags alone.
#[derive(Deserialize)]
struct Outline {
    number: u64,
    profile: ProfileName,
    command: Kind,
}

struct Joiner {
    site: Arc<Site>,
    asker: Asker,
    calls: mpsc::UnboundedSender<Call>,
    lines: mpsc::Sender<Vec<u8>>,
}

impl Joiner {
    /// Answers each line until the joiner leaves or sends something else than a request.
    async fn answer_lines(self, mut reader: BufReader<OwnedReadHalf>) {
        let most = match self.asker {
            Asker::Owner => LONGEST_LINE,
            Asker::Operator(_) => LONGEST_OF_OPERATOR,
        };
        let (mut line, waiting) = (Vec::new(), Arc::new(Semaphore::new(MOST_WAITING)));
        loop {
            line.clear();
            let Ok(place) = Arc::clone(&waiting).acquire_owned().await else { return };
            let Ok(true) = read_line(&mut reader, &mut line, most).await else { return };
            if let Asker::Operator(operator) = &self.asker {
                let Ok(outline) = serde_json::from_slice::<Outline>(&line) else { return };
                if outline.command.carries_passphrase() {
                    line.zeroize();
                    let refusal = self.site.refuse_passphrase(operator, &outline.profile);
                    answer(&self.lines, outline.number, Err(refusal)).await;
                    continue;
                }
            }
            let Ok(Numbered { number, with }) = serde_json::from_slice::<Numbered<Request>>(&line) else { return };
            let (sender, answered) = oneshot::channel();
            if self.calls.send(Call { request: with, answer: sender }).is_err() {
                return;
            }
            let (lines, guest) = (self.lines.clone(), self.site.welcome());
            tokio::spawn(async move {
                let _held = (guest, place);
                let with = answered.await.unwrap_or_else(|_| Err(site_gone()));
                answer(&lines, number, with).await;
            });
        }
    }
}

async fn answer(lines: &mpsc::Sender<Vec<u8>>, number: u64, with: Result<Reply>) {
    if let Some(line) = line_of(&FromSite::Answer { number, with: Box::new(with) }) {
        // The joiner may have gone.
        drop(lines.send(line).await);
    }
}

/// The owner's settings are not an operator's business.
fn greeting(site: &Site, asker: &Asker) -> Greeting {
    let settings = match asker {
        Asker::Owner => site.config().show(),
        Asker::Operator(_) => Vec::new(),
    };
    let settings = settings.into_iter().filter(|setting| BINDING.contains(&setting.name));
    Greeting {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        settings: settings.map(|setting| (setting.name.to_owned(), setting.value)).collect(),
        stays: site.is_to_stay(),
        has: site.needs,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_user_has_a_bounded_number_of_connections_and_takes_none_from_others() {
        let crowd = Arc::new(Crowd::default());
        let mut places: Vec<Place> = (0..MOST_CONNECTIONS).filter_map(|_| Place::take(&crowd, 1001)).collect();
        assert_eq!(places.len(), MOST_CONNECTIONS);
        assert!(Place::take(&crowd, 1001).is_none() && Place::take(&crowd, 1002).is_some());
        places.pop();
        assert!(Place::take(&crowd, 1001).is_some(), "one has left");
        drop(places);
        assert!(crowd.lock().is_ok_and(|users| users.is_empty()), "nobody is remembered");
    }
}
