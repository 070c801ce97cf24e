//! `bag follow`: what is being recorded, sealed while it is recorded.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::connect::{Context, ProfileNeed};
use super::parse;
use super::printed::Teller;
use super::recordings::absolute;
use super::serve::Ending;
use crate::model::ErrorKind;
use crate::service::command::{FollowFolder, FollowWishes, StopCapture};
use crate::service::event::NoticeLevel;
use crate::service::reply::{FollowView, FollowedFile};
use crate::service::{Client, Event, Failure, Needs};
use authros_output::{Output, table};

/// Between two lines about how far it is: it may go on for days.
const TELLING: Duration = Duration::from_secs(30);

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
    /// Also write NAME.authros.mcap beside each file, a copy with its proof as an attachment
    #[arg(long)]
    pub attach: bool,
}

impl FollowArguments {
    fn wishes(&self) -> Result<FollowWishes, Failure> {
        let tags: Result<Vec<_>, Failure> = self.tags.iter().map(|text| parse::tag(text)).collect();
        Ok(FollowWishes {
            folder: absolute(&self.folder)?,
            topics: parse::values(&self.topics)?,
            tags: tags?,
            until_closed: self.until_closed,
            attach: self.attach,
        })
    }
}

/// Follows; Ctrl-C ends it, a second one leaves at once.
///
/// # Errors
/// What the site or the arguments say.
pub async fn run(context: Context, arguments: FollowArguments, output: &Output) -> Result<u8, Failure> {
    let wishes = arguments.wishes()?;
    let connection = context.connect(Needs { ros: false, chain: true }).await?;
    let result = async {
        context.prepare(&connection.client, ProfileNeed::Made, output).await?;
        until_ended(&connection.client, wishes, output).await
    };
    let result = result.await;
    connection.close().await;
    let view = result?;
    output.result(&view, || followed(&view));
    Ok(code(&view, arguments.until_closed, output))
}

async fn until_ended(client: &Client, wishes: FollowWishes, output: &Output) -> Result<FollowView, Failure> {
    let mut events = client.events();
    let answer = client.ask(FollowFolder(wishes));
    tokio::pin!(answer);
    let (mut asked, mut teller, mut tick) = (false, Teller::default(), tokio::time::interval(TELLING));
    tick.reset();
    loop {
        tokio::select! {
            view = &mut answer => return view,
            Ok(event) = events.recv() => if let Event::Notice { at, level, text, about } = event
                && level >= NoticeLevel::Info
            {
                output.notice(at, level, about.as_deref(), &text);
            },
            _ = tick.tick() => teller.tell(client, output).await,
            ending = super::serve::asked_to_end() => {
                if asked || ending == Ending::Ordered {
                    return Err(Failure::new(ErrorKind::Incomplete, "stopped early; sealed records are stored, repeat \
                                                                    the command to go on"));
                }
                asked = true;
                output.note("stopping; what is sealed stays sealed (Ctrl-C again to quit now)");
                client.ask(StopCapture).await?;
            }
        }
    }
}

fn followed(view: &FollowView) -> String {
    let rows: Vec<Vec<String>> = view
        .files
        .iter()
        .map(|file| {
            let figures = [file.found, file.sealed, file.already, file.chunks].map(|figure| figure.to_string());
            let proof = if file.proof.is_some() { "yes" } else { "no" };
            [vec![file.file.clone()], figures.to_vec(), vec![proof.to_owned()]].concat()
        })
        .collect();
    let mut text = table(&["file", "found", "sealed", "already there", "chunks", "proof"], &rows);
    for file in &view.files {
        let name = &file.file;
        file.notes.iter().for_each(|note| text.push_str(&format!("\n{name}: {note}")));
        for damage in &file.damages {
            text.push_str(&format!("\n{name}: byte {}: {}", damage.position, damage.text));
        }
        for row in &file.left_out {
            text.push_str(&format!("\n{name}: left out: {} messages of '{}': {}", row.messages, row.topic, row.why));
        }
        if let Some(copy) = &file.attached {
            text.push_str(&format!("\n{name}: with its proof attached: {copy}"));
        }
    }
    text
}

fn code(view: &FollowView, until_closed: bool, output: &Output) -> u8 {
    if view.files.iter().any(|file| file.is_altered) {
        output.note("authros: a file is no longer what was sealed of it; the records tell what it was");
        return ErrorKind::Tampered.exit_code();
    }
    if view.is_gone {
        output.note(&format!("authros: {} is gone; what was read of it is sealed", view.folder));
        return ErrorKind::Incomplete.exit_code();
    }
    let is_whole = |file: &FollowedFile| {
        file.is_closed && file.proof.is_some() && file.damages.is_empty() && file.skipped + file.lost == 0
    };
    // Who ends it while it is recorded has what he wanted, where everything read was sealed.
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
