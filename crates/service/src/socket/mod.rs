//! A site's Unix sockets, for its owner and for operators. One JSON line per message: first the site's `Greeting`, or
//! why it refuses; then numbered requests and answers, and events. The kernel says who joins.

use std::collections::HashMap;
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{Semaphore, broadcast, mpsc, oneshot};
use zeroize::Zeroize as _;

use crate::client::{Call, Client, site_gone};
use crate::command::{Kind, Needed, Request};
use crate::crypto::hands::{self, Fault};
use crate::model::{ErrorKind, ProfileName, Timestamp, clean, locked};
use crate::paths::Home;
use crate::reply::{Event, Failure, NoticeLevel, Reply, Result, refused};
use crate::site::{Asker, Heard, Needs, Site, joiner};
use crate::store::files;

/// Bytes: an opened record of 64 MiB written as JSON.
const LONGEST_LINE: usize = 512 * 1024 * 1024;

/// Lines that may wait for a peer who does not read.
const QUEUE: usize = 1024;

/// Settings that must be the same for a joiner.
pub const BINDING: [&str; 8] = [
    "ros.master",
    "chain.url",
    "chain.contract",
    "chain.consensus",
    "robots",
    "crypto.provider",
    "site.address",
    "site.gateway_key",
];

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Greeting {
    pub version: String,
    /// Settings that bind the owner's joiners; operators get none.
    pub settings: Vec<(String, String)>,
    /// Whether the site stays, instead of ending with one command.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stays: bool,
    pub has: Needs,
}

#[derive(Serialize, Deserialize)]
struct Numbered<T> {
    number: u64,
    #[serde(flatten)]
    with: T,
}

/// `Refused` comes instead of `Greeting`; after `Ended` no more events are sent.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum FromSite {
    Greeting(Greeting),
    Refused(Failure),
    Answer { number: u64, with: Box<Result<Reply>> },
    Event(Event),
    Ended(Failure),
}

/// A path to the socket short enough for the kernel, however deep its folder is.
fn reachable(path: &Path) -> std::io::Result<(PathBuf, Option<std::fs::File>)> {
    if path.as_os_str().len() < 100 {
        return Ok((path.to_owned(), None));
    }
    let directory = std::fs::File::open(path.parent().unwrap_or(path))?;
    let name = path.file_name().unwrap_or_default();
    Ok((Path::new("/proc/self/fd").join(directory.as_raw_fd().to_string()).join(name), Some(directory)))
}

/// Listens with this mode; replaces a dead socket.
pub(crate) fn bind(path: &Path, mode: u32) -> std::io::Result<UnixListener> {
    let (short, _directory) = reachable(path)?;
    let is_socket = std::fs::symlink_metadata(path).is_ok_and(|about| about.file_type().is_socket());
    if is_socket && std::os::unix::net::UnixStream::connect(&short).is_err() {
        std::fs::remove_file(path)?;
    }
    let listener = UnixListener::bind(&short)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))?;
    Ok(listener)
}

fn line_of<T: Serialize>(message: &T) -> Option<Vec<u8>> {
    let mut line = serde_json::to_vec(message).ok()?;
    line.push(b'\n');
    Some(line)
}

async fn write_lines(mut writer: OwnedWriteHalf, mut queue: mpsc::Receiver<Vec<u8>>) {
    while let Some(line) = queue.recv().await {
        if writer.write_all(&line).await.is_err() {
            return;
        }
    }
}

/// Reads a line of at most `most` bytes; `false` at the end of the stream.
async fn read_line(
    reader: &mut (impl AsyncBufReadExt + Unpin),
    line: &mut Vec<u8>,
    most: usize,
) -> std::io::Result<bool> {
    loop {
        let chunk = reader.fill_buf().await?;
        if chunk.is_empty() {
            return Ok(false);
        }
        let (used, done) = match chunk.iter().position(|byte| *byte == b'\n') {
            Some(at) => (at + 1, true),
            None => (chunk.len(), false),
        };
        line.extend_from_slice(&chunk[..used]);
        reader.consume(used);
        if done {
            return Ok(true);
        }
        if line.len() > most {
            return Err(std::io::Error::other("a line is too long"));
        }
    }
}

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
        let mut users = locked(crowd);
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
        let mut users = locked(&self.crowd);
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

const PATIENCE: Duration = Duration::from_secs(5);

/// Joins the site of a home, if one answers; refuses a socket that somebody else could have put there.
pub async fn join(home: &Home, profile: ProfileName) -> Result<Option<(Client, Greeting)>> {
    if home.root().exists() {
        files::check_hands(home.root())?;
    }
    let Ok((path, _directory)) = reachable(&home.socket()) else { return Ok(None) };
    let Ok(stream) = UnixStream::connect(path).await else { return Ok(None) };
    let (owner, peer) = (std::fs::metadata(home.root()), stream.peer_cred());
    let (Ok(owner), Ok(peer)) = (owner, peer) else { return Ok(None) };
    check_peer(&home.socket(), owner.uid(), peer.uid())?;
    greeted(stream, profile, false).await
}

/// Only the owner or root may answer: the next message may be a passphrase.
fn check_peer(socket: &Path, owner: u32, peer: u32) -> Result<()> {
    if peer == owner || peer == 0 {
        return Ok(());
    }
    Err(refused(format!(
        "a process of user {peer} answers at {}, which belongs to user {owner}; nothing was sent to it: have root end that \
         process, and find out how it got there",
        socket.display()
    )))
}

/// Joins a site at the operators' socket, unless somebody else could answer there.
pub async fn join_as_operator(path: &Path, profile: ProfileName) -> Result<Client> {
    let shown = path.display();
    let absent = |why: String| {
        let advice = "its owner starts it with `authros serve` and operators.socket";
        Failure::new(ErrorKind::Unreachable, format!("no site answers at {shown} ({why}); {advice}"))
    };
    let failed = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::PermissionDenied => refused(format!(
            "you may not use {shown}; ask the site's owner to add you to the group of that socket, then log in again"
        )),
        _ => absent(error.to_string()),
    };
    let owner = owner_of(path, &failed)?;
    let (short, _directory) = reachable(path).map_err(failed)?;
    let stream = UnixStream::connect(short).await.map_err(failed)?;
    check_peer(path, owner, stream.peer_cred().map_err(failed)?.uid())?;
    let joined = greeted(stream, profile, true).await?;
    joined.map(|(client, _)| client).ok_or_else(|| absent("it does not greet".to_owned()))
}

/// The socket's owner; an error if anybody else but root could replace the socket.
fn owner_of(path: &Path, failed: &impl Fn(std::io::Error) -> Failure) -> Result<u32> {
    let about = std::fs::symlink_metadata(path).map_err(failed)?;
    if !about.file_type().is_socket() {
        return Err(Failure::new(ErrorKind::Input, format!("{} is not a socket; give that of a site", path.display())));
    }
    let folder = path.parent().unwrap_or(path);
    let why = match hands::fault(folder, about.uid()).map_err(failed)? {
        None => return Ok(about.uid()),
        Some(Fault::Foreign(folder)) => {
            format!("it belongs to user {} and {} to somebody else", about.uid(), folder.display())
        }
        Some(Fault::Open(folder)) => format!("others can write to {}", folder.display()),
    };
    Err(refused(format!("{} may not be the site's: {why}; ask the site's owner", path.display())))
}

/// A client of the site at the other end; `None` if it says nothing.
async fn greeted(stream: UnixStream, profile: ProfileName, is_operator: bool) -> Result<Option<(Client, Greeting)>> {
    let (reader, writer) = stream.into_split();
    let mut reader = BufReader::new(reader);
    let mut line = Vec::new();
    let said = tokio::time::timeout(PATIENCE, read_line(&mut reader, &mut line, LONGEST_LINE)).await;
    if !matches!(said, Ok(Ok(true))) {
        return Ok(None);
    }
    let greeting = match serde_json::from_slice(&line) {
        Ok(FromSite::Greeting(greeting)) => greeting,
        Ok(FromSite::Refused(failure)) => return Err(failure),
        _ => {
            let text = "the running site is of another version; stop it and start it again";
            return Err(Failure::new(ErrorKind::Home, text));
        }
    };
    let (events, _) = broadcast::channel(1024);
    let (calls, receiver) = mpsc::unbounded_channel();
    tokio::spawn(speak((reader, writer), is_operator, receiver, events.clone()));
    Ok(Some((Client::new(profile, calls, events), greeting)))
}

/// The last event, where the site sends no more.
fn sends_no_more(refusal: &Failure) -> Event {
    let text = format!("this site reports no further events: {}", clean(&refusal.message, 500));
    Event::Notice { at: Timestamp::now(), level: NoticeLevel::Error, text, about: None }
}

async fn speak(
    (mut reader, writer): (BufReader<OwnedReadHalf>, OwnedWriteHalf),
    is_operator: bool,
    mut calls: mpsc::UnboundedReceiver<Call>,
    events: broadcast::Sender<Event>,
) {
    let (lines, queue) = mpsc::channel(QUEUE);
    tokio::spawn(write_lines(writer, queue));
    let (arrived, mut messages) = mpsc::unbounded_channel();
    tokio::spawn(async move {
        let mut line = Vec::new();
        while let Ok(true) = read_line(&mut reader, &mut line, LONGEST_LINE).await {
            let message = serde_json::from_slice::<FromSite>(&line).ok();
            let was_read = message.is_some();
            if arrived.send(message).is_err() || !was_read {
                return;
            }
            line.clear();
        }
    });
    let mut waiting: HashMap<u64, oneshot::Sender<Result<Reply>>> = HashMap::new();
    let mut number = 0;
    loop {
        tokio::select! {
            call = calls.recv() => {
                let Some(Call { request, answer }) = call else { return };
                if is_operator && request.command.needs() == Needed::Passphrase {
                    let text = "an operator sends no passphrase; the site's owner does this, in a console or command of their own";
                    drop(answer.send(Err(refused(text))));
                    continue;
                }
                number += 1;
                let Some(line) = line_of(&Numbered { number, with: request }) else { continue };
                waiting.insert(number, answer);
                if lines.send(line).await.is_err() {
                    return;
                }
            }
            message = messages.recv() => match message {
                // Nobody may be waiting for the answer any more.
                Some(Some(FromSite::Answer { number, with })) => {
                    if let Some(answer) = waiting.remove(&number) {
                        drop(answer.send(*with));
                    }
                }
                Some(Some(FromSite::Event(event))) => drop(events.send(event)),
                Some(Some(FromSite::Ended(refusal))) => drop(events.send(sends_no_more(&refusal))),
                Some(Some(FromSite::Greeting(_) | FromSite::Refused(_))) => {}
                // An unreadable line may be the answer to any of them.
                Some(None) => {
                    for (_, answer) in waiting.drain() {
                        drop(answer.send(Err(Failure::of_another_version())));
                    }
                    return;
                }
                None => return,
            },
        }
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

#[cfg(test)]
mod joining_tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use std::fs::{Permissions, set_permissions};
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;
    use crate::socket::bind;

    #[test]
    fn nobody_but_the_owner_and_root_is_sent_anything() {
        let socket = Path::new("/srv/home/site.sock");
        assert!(check_peer(socket, 1000, 1000).is_ok() && check_peer(socket, 1000, 0).is_ok());
        for (owner, peer) in [(1000, 1001), (0, 1000)] {
            let refusal = check_peer(socket, owner, peer).expect_err("somebody else");
            assert!(refusal.kind == ErrorKind::Refused && refusal.message.contains("nothing was sent"), "{refusal:?}");
        }
    }

    #[tokio::test]
    async fn a_home_that_others_can_write_is_not_joined() {
        let folder = tempfile::tempdir().expect("a folder");
        let home = Home::new(folder.path().join("home"));
        assert!(join(&home, ProfileName::default()).await.expect("nobody").is_none(), "no home yet");
        std::fs::create_dir(home.root()).expect("a home");
        let _listener = bind(&home.socket(), 0o666).expect("listens");
        set_permissions(home.root(), Permissions::from_mode(0o777)).expect("its mode");
        let refusal = join(&home, ProfileName::default()).await.map(|_| ()).expect_err("not joined");
        assert!(refusal.kind == ErrorKind::Refused && refusal.message.contains("chmod go-w"), "{refusal:?}");
    }

    #[tokio::test]
    async fn a_socket_that_somebody_else_could_have_put_there_is_not_joined() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("operators.sock");
        let join = async || join_as_operator(&path, ProfileName::default()).await.expect_err("not joined");
        let none = join().await;
        assert!(none.kind == ErrorKind::Unreachable && none.message.contains("authros serve"), "{none:?}");
        std::fs::write(&path, "").expect("a file");
        assert_eq!(join().await.kind, ErrorKind::Input);
        std::fs::remove_file(&path).expect("removed");
        let listener = bind(&path, 0o660).expect("listens");
        for mode in [0o770, 0o702, 0o1777] {
            set_permissions(folder.path(), Permissions::from_mode(mode)).expect("its mode");
            let refusal = join().await;
            assert!(refusal.kind == ErrorKind::Refused && refusal.message.contains("others can write"), "{refusal:?}");
        }
        drop(listener);
        set_permissions(folder.path(), Permissions::from_mode(0o700)).expect("its mode");
        assert_eq!(join().await.kind, ErrorKind::Unreachable, "nobody answers");
    }
}
