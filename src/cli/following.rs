//! `bag follow`: what is being recorded, sealed while it is recorded.

use std::{convert::Infallible, future::pending, path::PathBuf, time::Duration};

use clap::Args;
use tokio::sync::broadcast::Receiver;

use super::connect::{Context, ProfileNeed};
use super::parse::{self, absolute};
use super::{plan::CHAIN, printed, serve, serve::until_done};
use crate::model::{ErrorKind, counted};
use crate::service::command::{FollowFolder, FollowWishes, StopCapture};
use crate::service::reply::{FollowView, FollowedFile};
use crate::service::{Client, Event, Failure, NoticeLevel};
use authros_output::{Output, table};

/// Interval of progress lines: a recording may last for days.
const TELLING: Duration = Duration::from_secs(30);
/// Grace for notices that were sent before the answer.
const LAST_WORDS: Duration = Duration::from_millis(100);

/// `bag follow …`
#[derive(Debug, Args)]
pub struct FollowArguments {
    /// The folder into which a recorder writes MCAP or .db3 files; it need not exist yet
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Only topics matching this pattern, such as /robot*/odom; repeatable [default: all topics]
    #[arg(long = "topic", value_name = "PATTERN")]
    pub topics: Vec<String>,
    /// Tag, sealed with each record, such as mission=harbour; repeatable
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
    /// End once the recording is closed and its proofs are written [default: until Ctrl-C]
    #[arg(long)]
    pub until_closed: bool,
}

pub async fn run(context: Context, arguments: FollowArguments, output: &Output) -> Result<u8, Failure> {
    let (folder, topics) = (absolute(&arguments.folder)?, parse::values(&arguments.topics)?);
    let (tags, until_closed) = (parse::tags(&arguments.tags)?, arguments.until_closed);
    let wishes = FollowWishes { folder, topics, tags, until_closed };
    let words = (
        "stopping; what is sealed stays sealed",
        "stopped early; sealed records are stored, repeat the command to continue",
    );
    let follow = async |client: &Client| {
        let mut events = client.events();
        let telling = tell(client, &mut events, output);
        let answer = until_done(client, FollowFolder(wishes), StopCapture, words, output, telling).await;
        let rest = serve::follow(&mut events, NoticeLevel::Info, output, pending());
        drop(tokio::time::timeout(LAST_WORDS, rest).await);
        answer
    };
    let view = context.with(CHAIN, ProfileNeed::Made, output, follow).await?;
    output.result(&view, || followed(&view));
    Ok(code(&view, until_closed, output))
}

/// Notices and progress; never ends.
async fn tell(client: &Client, events: &mut Receiver<Event>, output: &Output) -> Infallible {
    let told = serve::follow(events, NoticeLevel::Info, output, pending());
    // After the site's end only the answer is missing.
    let (never, ()) = tokio::join!(printed::tell_on(client, TELLING, output), told);
    never
}

fn followed(view: &FollowView) -> String {
    let row = |file: &FollowedFile| {
        let figures = [file.found, file.sealed, file.already, file.chunks].map(|figure| figure.to_string());
        let proof = if file.proof.is_some() { "yes" } else { "no" };
        [vec![file.file.clone()], figures.to_vec(), vec![proof.to_owned()]].concat()
    };
    let head = ["file", "found", "sealed", "already there", "chunks", "proof"];
    let mut text = table(&head, view.files.iter().map(row));
    for file in &view.files {
        let name = &file.file;
        file.notes.iter().for_each(|note| text.push_str(&format!("\n{name}: {note}")));
        for damage in &file.damages {
            text.push_str(&format!("\n{name}: byte {}: {}", damage.position, damage.text));
        }
        for row in &file.left_out {
            text.push_str(&format!(
                "\n{name}: left out: {} of '{}': {}",
                counted(row.messages, "message"),
                row.topic,
                row.why
            ));
        }
    }
    text
}

fn code(view: &FollowView, until_closed: bool, output: &Output) -> u8 {
    if view.files.iter().any(|file| file.is_altered) {
        output.note("authros: a file has changed since it was sealed; its records prove what it was");
        return ErrorKind::Tampered.exit_code();
    }
    if view.is_gone {
        output.note(&format!("authros: {} is gone; everything read of it is sealed", view.folder));
        return ErrorKind::Incomplete.exit_code();
    }
    let is_whole = |file: &FollowedFile| {
        file.is_closed && file.proof.is_some() && file.damages.is_empty() && file.skipped + file.lost == 0
    };
    // Ending it early is success where everything read was sealed.
    let is_sound = |file: &FollowedFile| is_whole(file) || !until_closed && file.digest.is_none() && file.lost == 0;
    if view.files.is_empty() {
        output.note("authros: no recording appeared there");
    }
    if view.files.iter().all(is_sound) && !(until_closed && view.ended_early) {
        return 0;
    }
    output.note("authros: not everything is sealed and proven; the list says what is missing");
    ErrorKind::Incomplete.exit_code()
}
