//! `bag import`, `bag export` and `records import`: recordings and other homes, with progress on stderr.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::connect::{Context, ProfileNeed};
use super::parse::{self, absolute, usage};
use super::printed::{self, LOOK};
use super::{plan::CHAIN, serve::until_done};
use crate::model::counted;
use crate::ros::recording::{ChunkCompression, RecordingFormat};
use crate::service::command::{self, Ask};
use crate::service::reply::{ExportView, ExportedTopic, ImportView};
use crate::service::{Client, Failure};
use crate::{crypto::private_file, model::ErrorKind, paths::Home, store::files};
use authros_output::{Output, table};

/// The longest keyring copied, bytes.
const LONGEST_KEYRING: usize = 1 << 20;

/// `bag …`
#[derive(Debug, Subcommand)]
pub enum BagVerb {
    /// Import a bag, an MCAP or .db3 file or a folder of rosbag2 as records, keeping its times
    Import(ImportArguments),
    /// Seal what a recorder writes into a folder, while it writes, and prove its files
    Follow(super::following::FollowArguments),
    /// Export all readable records, own and received, as a bag or MCAP file, each one verified first
    Export(ExportArguments),
}

/// `bag import …`
#[derive(Debug, Args)]
pub struct ImportArguments {
    /// A bag (rosbag 2.0), an MCAP or .db3 file, or a folder of rosbag2
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Only topics matching this pattern, such as /robot*/odom; repeatable [default: all topics]
    #[arg(long = "topic", value_name = "PATTERN")]
    pub topics: Vec<String>,
    /// Only topics of this robot, as robot1 for /robot1/**; repeatable
    #[arg(long = "robot", value_name = "NAME")]
    pub of_robots: Vec<String>,
    /// Tag, sealed with each record, such as mission=harbour; repeatable
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
    /// Import again what an earlier import of the same file already sealed
    #[arg(long)]
    pub again: bool,
}

/// `bag export …`
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("format").required(true).multiple(false)))]
pub struct ExportArguments {
    /// Write a bag (rosbag 2.0)
    #[arg(long, value_name = "FILE", group = "format")]
    pub bag: Option<PathBuf>,
    /// Write MCAP
    #[arg(long, value_name = "FILE", group = "format")]
    pub mcap: Option<PathBuf>,
    /// Write a folder of rosbag2: an MCAP file and its metadata.yaml
    #[arg(long, value_name = "FOLDER", group = "format")]
    pub rosbag2: Option<PathBuf>,
    /// Only this owner's, by account or name [default: own and shared records]
    #[arg(long, value_name = "ACCOUNT")]
    pub owner: Option<String>,
    /// Only topics matching this pattern; repeatable
    #[arg(long = "topic", value_name = "PATTERN")]
    pub topics: Vec<String>,
    /// Only topics of this robot, as robot1 for /robot1/**; repeatable
    #[arg(long = "robot", value_name = "NAME")]
    pub of_robots: Vec<String>,
    /// Captured at or after: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub since: Option<String>,
    /// Captured before; same format
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub until: Option<String>,
    /// none, bz2 (bag), lz4, zstd (MCAP, rosbag2)
    #[arg(long, value_name = "HOW", default_value = "none")]
    pub compression: String,
    /// Include records that the chain does not confirm yet, or cannot be asked about; all other checks still apply
    #[arg(long)]
    pub unanchored: bool,
}

impl ExportArguments {
    fn wishes(&self, output: &Output) -> Result<command::ExportWishes, Failure> {
        let (path, format) = match (&self.bag, &self.mcap, &self.rosbag2) {
            (Some(path), ..) => (path, RecordingFormat::Bag),
            (_, Some(path), _) => (path, RecordingFormat::Mcap),
            (.., Some(path)) => (path, RecordingFormat::Rosbag2),
            (None, None, None) => {
                return Err(usage("give the file with --bag or --mcap, or a folder with --rosbag2"));
            }
        };
        let (path, compression) = (absolute(path)?, parse::value::<ChunkCompression>(&self.compression)?);
        let (owner, topics) = (parse::optional(self.owner.as_deref())?, parse::topics(&self.topics, &self.of_robots)?);
        let times = parse::Times::now(output);
        let (since, until) = (times.since(self.since.as_deref())?, times.until(self.until.as_deref())?);
        let unanchored = self.unanchored;
        Ok(command::ExportWishes { path, format, compression, owner, topics, since, until, unanchored })
    }
}

pub async fn import(context: Context, arguments: ImportArguments, output: &Output) -> Result<u8, Failure> {
    let (topics, tags) = (parse::topics(&arguments.topics, &arguments.of_robots)?, parse::tags(&arguments.tags)?);
    let wishes = command::ImportWishes { path: absolute(&arguments.file)?, topics, tags, again: arguments.again };
    let view = run(context, command::ImportRecording(wishes), ProfileNeed::Made, output).await?;
    output.result(&view, || imported(&view));
    Ok(import_code(&view, output))
}

pub async fn import_home(context: Context, home: &Path, output: &Output) -> Result<u8, Failure> {
    let home = absolute(home)?;
    bring_keyring(&context, &home, output)?;
    let view = run(context, command::ImportHome { home }, ProfileNeed::Unlocked, output).await?;
    output.result(&view, || imported(&view));
    Ok(import_code(&view, output))
}

/// Also copies the passphrase stored beside it.
fn bring_keyring(context: &Context, from: &Path, output: &Output) -> Result<(), Failure> {
    let (old, profile) = (Home::new(from.to_owned()), &context.profile);
    let (source, target) = (old.keyring(profile), context.home.keyring(profile));
    if target.exists() {
        return Ok(());
    }
    if !source.exists() {
        let text = format!("{} has no profile '{profile}'; name one of its profiles with --profile", from.display());
        return Err(Failure::new(ErrorKind::Input, text));
    }
    files::private_directory(context.home.root())?;
    files::private_directory(&context.home.profile(profile))?;
    for (source, target) in [(old.passphrase(profile), context.home.passphrase(profile)), (source, target)] {
        if source.exists() && !target.exists() {
            private_file::create_private(&target, &private_file::read_private(&source, LONGEST_KEYRING)?)?;
        }
    }
    output.note(&format!(
        "the keyring of profile '{profile}' was copied from {}; its passphrase is the same",
        from.display()
    ));
    Ok(())
}

pub async fn export(context: Context, arguments: ExportArguments, output: &Output) -> Result<u8, Failure> {
    let view = run(context, command::ExportRecording(arguments.wishes(output)?), ProfileNeed::Unlocked, output).await?;
    output.result(&view, || exported(&view));
    Ok(export_code(&view, output))
}

async fn run<A: Ask>(context: Context, ask: A, need: ProfileNeed, output: &Output) -> Result<A::Answer, Failure> {
    let words = (
        "stopping; sealed records are verified first",
        "stopped early; sealed records are stored, repeat the command to continue",
    );
    let until_done = async |client: &Client| {
        until_done(client, ask, command::StopCapture, words, output, printed::tell_on(client, LOOK, output)).await
    };
    context.with(CHAIN, need, output, until_done).await
}

fn imported(view: &ImportView) -> String {
    let rows = view.topics.iter().map(|topic| {
        [topic.topic.clone(), topic.imported.to_string(), topic.verified.to_string(), topic.already.to_string()]
    });
    let mut text = table(&["topic", "captured", "verified", "already there"], rows);
    for damage in &view.damages {
        text.push_str(&format!("\nbyte {}: {}", damage.position, damage.text));
    }
    for topic in &view.left_out {
        text.push_str(&format!(
            "\nleft out: {} of '{}': {}",
            counted(topic.messages, "message"),
            topic.topic,
            topic.why
        ));
    }
    if view.unguarded > 0 {
        text.push_str(&format!(
            "\nwithout a checksum in this file, so that alterations before the import cannot be detected: {}",
            counted(view.unguarded, "message")
        ));
    }
    text
}

fn import_code(view: &ImportView, output: &Output) -> u8 {
    if view.topics.iter().any(|topic| topic.verified < topic.imported) {
        output.note(printed::TAMPERED);
        return ErrorKind::Tampered.exit_code();
    }
    let damages = view.damages.len() as u64 + view.more_damages;
    if damages > 0 {
        output.note(&format!(
            "authros: the recording is damaged in {}; everything readable was imported",
            counted(damages, "place")
        ));
    }
    if view.unfinished {
        output.note(
            "authros: the bag has no index: its recorder was killed before it closed it; what could be read was imported, and \
             messages after that may be missing",
        );
    }
    if view.skipped > 0 {
        output.note(&format!("authros: left out: {}", counted(view.skipped, "message")));
    }
    if view.ended_early {
        output.note("authros: stopped before the end; repeat the command to continue");
    }
    if view.imported == 0 && view.already > 0 && !view.ended_early {
        output.note("authros: all of it was imported before, nothing was sealed twice");
    }
    let whole = damages == 0 && view.skipped == 0 && view.lost == 0 && !view.ended_early;
    let nothing = view.imported + view.already + view.attachments == 0;
    let is_empty = whole && view.found == 0;
    if is_empty {
        output.note("authros: it contains no messages, so there was nothing to import");
    } else if nothing && view.skipped == 0 {
        output.note("authros: it contains no messages of these topics; name others with --topic");
    }
    if whole && (is_empty || !nothing) { 0 } else { ErrorKind::Incomplete.exit_code() }
}

fn exported(view: &ExportView) -> String {
    let row = |topic: &ExportedTopic| [topic.topic.clone(), topic.type_name.clone(), topic.messages.to_string()];
    let list = table(&["topic", "type", "messages"], view.topics.iter().map(row));
    let messages = counted(view.messages, "message");
    match &view.file {
        Some(file) if view.attachments > 0 => {
            format!("{list}\n{messages} and {} written to {file}", counted(view.attachments, "attachment"))
        }
        Some(file) => format!("{list}\n{messages} written to {file}"),
        None => "nothing written: no readable record matches".to_owned(),
    }
}

fn export_code(view: &ExportView, output: &Output) -> u8 {
    let refused = view.refused;
    let words = [
        (refused.tampered, "different from what was anchored"),
        (refused.missing, "missing from the store"),
        (refused.false_names, "with a false name, written by the signer"),
        (refused.unanchored, "not confirmed by the chain now (--unanchored writes them too)"),
        (refused.no_key, "not readable with this profile's keys"),
        (refused.held, "quarantined or discarded"),
        (refused.no_definition, "of a type without a readable definition"),
        (refused.unsuitable, "unfit for this format"),
        (refused.attachments, "attached to a recording, which only MCAP has room for (--mcap, --rosbag2)"),
    ];
    for (count, why) in words.into_iter().filter(|(count, _)| *count > 0) {
        output.note(&format!("authros: not written: {} {why}", counted(count, "record")));
    }
    if !view.given.is_empty() {
        output.note(&format!(
            "authros: the definitions of {} are as the publishing nodes gave them: the type hash proves names and types of fields, \
             not comments, constants or default values",
            view.given.join(", ")
        ));
    }
    if refused.tampered + refused.missing > 0 {
        return ErrorKind::Tampered.exit_code();
    }
    if refused.false_names > 0 {
        return ErrorKind::Refused.exit_code();
    }
    let left = refused.unanchored + refused.no_key + refused.no_definition + refused.unsuitable + refused.attachments;
    if left > 0 || view.file.is_none() { ErrorKind::Incomplete.exit_code() } else { 0 }
}
