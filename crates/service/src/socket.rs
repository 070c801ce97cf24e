//! The home's Unix socket: further processes of the same user join the running site through it.
//!
//! One JSON line per message. The site speaks first (`Greeting`), so that a joiner can compare settings; then requests
//! with a number, answers with that number, and events.

use std::collections::HashMap;
use std::os::fd::AsRawFd;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{broadcast, mpsc, oneshot};

use super::client::{Call, Client};
use super::command::Request;
use super::event::{Event, NoticeLevel};
use super::reply::{Failure, Reply};
use super::site::{Heard, Site, joiner};
use crate::model::{ErrorKind, ProfileName, Timestamp, clean};
use crate::paths::Home;

/// The longest line accepted, bytes: an opened record of 64 MiB written as JSON.
const LONGEST_LINE: usize = 512 * 1024 * 1024;

/// The site's first line.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Greeting {
    /// Version of the program.
    pub version: String,
    /// Settings that bind every joiner: name and value.
    pub settings: Vec<(String, String)>,
    /// Whether only operators are answered, and whoever gives a passphrase.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub operators_required: bool,
    /// Whether the site is to stay, and does not end with the command that it runs for.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stays: bool,
}

#[derive(Serialize, Deserialize)]
struct Numbered<T> {
    number: u64,
    #[serde(flatten)]
    with: T,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum FromSite {
    Greeting(Greeting),
    Answer {
        number: u64,
        with: Box<Result<Reply, Failure>>,
    },
    Event(Event),
    /// No further events are told, and why.
    Ended(Failure),
}

/// A path to the socket that is short enough for the kernel, however deep the home is.
fn reachable(path: &Path) -> std::io::Result<(PathBuf, Option<std::fs::File>)> {
    if path.as_os_str().len() < 100 {
        return Ok((path.to_owned(), None));
    }
    let directory = std::fs::File::open(path.parent().unwrap_or(path))?;
    let name = path.file_name().unwrap_or_default();
    Ok((Path::new("/proc/self/fd").join(directory.as_raw_fd().to_string()).join(name), Some(directory)))
}

/// Accepts joiners until the site ends.
///
/// # Errors
/// If the socket cannot be made.
pub fn listen(site: &Arc<Site>) -> Result<(), Failure> {
    let path = site.home().socket();
    let unusable = |error: std::io::Error| {
        Failure::new(ErrorKind::Home, format!("the socket {} cannot be created: {error}", path.display()))
    };
    match std::fs::remove_file(&path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(unusable(error)),
        _ => {}
    }
    let (short, _directory) = reachable(&path).map_err(unusable)?;
    let listener = UnixListener::bind(&short).map_err(unusable)?;
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).map_err(unusable)?;
    let listener = Arc::new(listener);
    site.supervise("socket", move |site| accept(site, Arc::clone(&listener)));
    Ok(())
}

async fn accept(site: Arc<Site>, listener: Arc<UnixListener>) {
    loop {
        tokio::select! {
            joined = listener.accept() => {
                if let Ok((stream, _)) = joined {
                    tokio::spawn(serve_joiner(Arc::clone(&site), stream));
                } else {
                    tokio::time::sleep(std::time::Duration::from_millis(100)).await;
                }
            }
            () = site.stopped() => return,
        }
    }
}

async fn serve_joiner(site: Arc<Site>, stream: UnixStream) {
    let (reader, writer) = stream.into_split();
    let (lines, queue) = mpsc::unbounded_channel();
    tokio::spawn(write_lines(writer, queue));
    send(&lines, &FromSite::Greeting(greeting(&site)));
    let claims = joiner();
    let heard = lines.clone();
    let telling = tokio::spawn(Arc::clone(&site).tell_events(Arc::clone(&claims), move |what| match what {
        Heard::Event(event) => send(&heard, &FromSite::Event(event)),
        Heard::Ended(refusal) => send(&heard, &FromSite::Ended(refusal)),
    }));
    let (calls, receiver) = mpsc::unbounded_channel();
    tokio::spawn(Arc::clone(&site).serve(receiver, claims));
    answer_lines(&site, BufReader::new(reader), &calls, &lines).await;
    // Whoever is told nothing would never be found to have gone.
    telling.abort();
}

/// Answers each line of a joiner until it leaves.
async fn answer_lines(
    site: &Arc<Site>,
    mut reader: BufReader<OwnedReadHalf>,
    calls: &mpsc::UnboundedSender<Call>,
    lines: &mpsc::UnboundedSender<Vec<u8>>,
) {
    let mut line = Vec::new();
    loop {
        line.clear();
        match read_line(&mut reader, &mut line).await {
            Ok(true) => {}
            _ => return,
        }
        let Ok(Numbered { number, with }) = serde_json::from_slice::<Numbered<Request>>(&line) else { return };
        let (answer, answered) = oneshot::channel();
        if calls.send(Call { request: with, answer }).is_err() {
            return;
        }
        let (lines, guest) = (lines.clone(), site.welcome());
        tokio::spawn(async move {
            let _guest = guest;
            let with = answered.await.unwrap_or_else(|_| Err(super::client::site_gone()));
            send(&lines, &FromSite::Answer { number, with: Box::new(with) });
        });
    }
}

/// Settings that must be the same for a joiner.
pub fn greeting(site: &Site) -> Greeting {
    let binding = [
        "ros.master",
        "chain.url",
        "chain.contract",
        "chain.consensus",
        "vault.url",
        "robots",
        "crypto.provider",
        "site.address",
        "site.gateway_key",
    ];
    let settings = site.config().show().into_iter().filter(|setting| binding.contains(&setting.name));
    Greeting {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        settings: settings.map(|setting| (setting.name.to_owned(), setting.value)).collect(),
        operators_required: site.config().operators_required,
        stays: site.is_to_stay(),
    }
}

fn send<T: Serialize>(lines: &mpsc::UnboundedSender<Vec<u8>>, message: &T) -> bool {
    let Ok(mut line) = serde_json::to_vec(message) else { return false };
    line.push(b'\n');
    lines.send(line).is_ok()
}

async fn write_lines(mut writer: OwnedWriteHalf, mut queue: mpsc::UnboundedReceiver<Vec<u8>>) {
    while let Some(line) = queue.recv().await {
        if writer.write_all(&line).await.is_err() {
            return;
        }
    }
}

async fn read_line(reader: &mut (impl AsyncBufReadExt + Unpin), line: &mut Vec<u8>) -> std::io::Result<bool> {
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
        if line.len() > LONGEST_LINE {
            return Err(std::io::Error::other("a line is too long"));
        }
    }
}

/// Joins the site of a home, if one answers on its socket.
///
/// # Errors
/// If the socket exists but is not answered by a site of this version.
pub async fn join(home: &Home, profile: ProfileName) -> Result<Option<(Client, Greeting)>, Failure> {
    let Ok((path, _directory)) = reachable(&home.socket()) else { return Ok(None) };
    let Ok(stream) = UnixStream::connect(path).await else { return Ok(None) };
    let (reader, writer) = stream.into_split();
    let mut reader = BufReader::new(reader);
    let mut line = Vec::new();
    let greeted = tokio::time::timeout(std::time::Duration::from_secs(5), read_line(&mut reader, &mut line)).await;
    if !matches!(greeted, Ok(Ok(true))) {
        return Ok(None);
    }
    let Ok(FromSite::Greeting(greeting)) = serde_json::from_slice(&line) else {
        return Err(Failure::new(
            ErrorKind::Home,
            "the running site of this home is another version; stop it and start it again",
        ));
    };
    let (events, _) = broadcast::channel(1024);
    let (calls, receiver) = mpsc::unbounded_channel();
    tokio::spawn(speak(reader, writer, receiver, events.clone()));
    Ok(Some((Client::new(profile, calls, events), greeting)))
}

/// What those here hear last who are told nothing more.
fn told_no_more(refusal: &Failure) -> Event {
    let text = format!("this site tells nothing more of what happens: {}", clean(&refusal.message, 500));
    Event::Notice { at: Timestamp::now(), level: NoticeLevel::Error, text, about: None }
}

async fn speak(
    mut reader: BufReader<OwnedReadHalf>,
    writer: OwnedWriteHalf,
    mut calls: mpsc::UnboundedReceiver<Call>,
    events: broadcast::Sender<Event>,
) {
    let (lines, queue) = mpsc::unbounded_channel();
    tokio::spawn(write_lines(writer, queue));
    let (arrived, mut messages) = mpsc::unbounded_channel();
    tokio::spawn(async move {
        let mut line = Vec::new();
        while let Ok(true) = read_line(&mut reader, &mut line).await {
            let Ok(message) = serde_json::from_slice::<FromSite>(&line) else { return };
            if arrived.send(message).is_err() {
                return;
            }
            line.clear();
        }
    });
    let mut waiting: HashMap<u64, oneshot::Sender<Result<Reply, Failure>>> = HashMap::new();
    let mut number = 0;
    loop {
        tokio::select! {
            call = calls.recv() => {
                let Some(Call { request, answer }) = call else { return };
                number += 1;
                waiting.insert(number, answer);
                send(&lines, &Numbered { number, with: request });
            }
            message = messages.recv() => match message {
                Some(FromSite::Answer { number, with }) => {
                    if let Some(answer) = waiting.remove(&number) {
                        // It is not an error if nobody waits for the answer any more.
                        drop(answer.send(*with));
                    }
                }
                Some(FromSite::Event(event)) => drop(events.send(event)),
                Some(FromSite::Ended(refusal)) => drop(events.send(told_no_more(&refusal))),
                Some(FromSite::Greeting(_)) => {}
                None => return,
            },
        }
    }
}
