//! A joiner's side: the owner's at the home's socket, an operator's outside it. An operator checks whose socket it is,
//! and sends no passphrase.

use std::collections::HashMap;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::path::Path;
use std::time::Duration;

use tokio::io::BufReader;
use tokio::net::UnixStream;
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::{broadcast, mpsc, oneshot};

use super::{FromSite, Greeting, LONGEST_LINE, Numbered, QUEUE, line_of, reachable, read_line, write_lines};
use crate::crypto::hands::{self, Fault};
use crate::model::{ErrorKind, ProfileName, Timestamp, clean};
use crate::paths::Home;
use crate::service::client::{Call, Client};
use crate::service::command::Needed;
use crate::service::event::{Event, NoticeLevel};
use crate::service::failure::refused;
use crate::service::reply::{Failure, Reply, Result};
use crate::store::files;

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
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use std::fs::{Permissions, set_permissions};
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;
    use crate::service::socket::bind;

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
