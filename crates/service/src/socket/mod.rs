//! A site's Unix sockets, for its owner and for operators. One JSON line per message: first the site's `Greeting`, or
//! why it refuses; then numbered requests and answers, and events. The kernel says who joins.

mod joining;
mod serving;

use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt};
use tokio::net::UnixListener;
use tokio::net::unix::OwnedWriteHalf;
use tokio::sync::mpsc;

pub use joining::{join, join_as_operator};
pub(crate) use serving::accept_operators;
pub use serving::listen;

use super::event::Event;
use super::reply::{Failure, Reply, Result};
use crate::site::Needs;

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
