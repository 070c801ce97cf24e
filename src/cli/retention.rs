//! `records erase`: chosen records; what rules delete is decided by the settings.

use std::io::{IsTerminal as _, Read as _};
use std::path::Path;

use clap::Args;

use super::connect::{Context, ProfileNeed};
use super::{parse, plan::CHAIN};
use crate::model::{ByteSize, Digest, ErrorKind, clean};
use crate::service::command::{EraseRecords, ErasureWishes};
use crate::service::{Client, Failure, failure::input, reply::ErasureView};
use crate::{crypto::Sm3Hasher, ros::recording::content_of};
use authros_output::Output;

const WORD: &str = "erase";
/// Characters of an imported file's tag.
const TAG: usize = 16;

/// `records erase …`
#[derive(Debug, Args)]
pub struct EraseArguments {
    /// Messages of this topic
    #[arg(long, required_unless_present_any = ["records", "recording"])]
    pub topic: Option<String>,
    /// Messages that were imported from this bag or MCAP file; without the file, its tag 'recording'
    #[arg(long, value_name = "FILE")]
    pub recording: Option<String>,
    /// Captured at or after: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub since: Option<String>,
    /// Captured before; same format
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub until: Option<String>,
    /// These records, by their ids
    #[arg(long = "record", value_name = "ID", num_args = 1..)]
    #[arg(conflicts_with_all = ["topic", "recording", "since", "until"])]
    pub records: Vec<String>,
    /// Why; shown with the records from then on
    #[arg(long, value_name = "TEXT")]
    pub reason: String,
    /// Erase without asking; without it, what would go is shown
    #[arg(long)]
    pub yes: bool,
}

pub async fn run(context: Context, arguments: EraseArguments, output: &Output) -> Result<u8, Failure> {
    let EraseArguments { topic, recording, since, until, records, reason, yes } = arguments;
    let topic = parse::optional(topic.as_deref())?;
    let times = parse::Times::now(output);
    let (since, until) = (times.since(since.as_deref())?, times.until(until.as_deref())?);
    let recording = recording.as_deref().map(tag_of).transpose()?;
    let wishes = ErasureWishes { topic, since, until, records, recording, reason, sure: yes };
    let asks = !yes && !context.global.json && std::io::stdin().is_terminal();
    let erase = async |client: &Client| erase(client, wishes, asks, output).await;
    context.with(CHAIN, ProfileNeed::Unlocked, output, erase).await
}

async fn erase(client: &Client, wishes: ErasureWishes, asks: bool, output: &Output) -> Result<u8, Failure> {
    let sure = wishes.sure;
    let view = client.ask(EraseRecords(wishes.clone())).await?;
    if view.records + view.named + view.waiting + view.gone + view.other + view.missing == 0 {
        let what = "no message of yours has that topic and time; `authros records list` shows yours";
        return Err(input(format!("nothing matches: {what}")));
    }
    let is_sure = asks && view.records > 0 && view.held.is_empty() && {
        output.note(&text(&view));
        output.note(&format!("type '{WORD}' to erase them permanently:"));
        parse::typed(WORD)
    };
    let view = if is_sure { client.ask(EraseRecords(ErasureWishes { sure: true, ..wishes })).await? } else { view };
    output.result(&view, || text(&view));
    // Without a confirmation, a script must not take it for done.
    let unconfirmed = !sure && !asks && view.records > 0;
    Ok(if unconfirmed { ErrorKind::Usage.exit_code() } else { 0 })
}

/// The beginning of the file's SM3, or the tag itself.
fn tag_of(file: &str) -> Result<String, Failure> {
    if file.len() == TAG && file.bytes().all(|byte| byte.is_ascii_hexdigit()) && !Path::new(file).exists() {
        return Ok(file.to_ascii_lowercase());
    }
    let unreadable = |error: &dyn std::fmt::Display| {
        let advice = "name the file that was imported, or the tag 'recording' of its messages";
        input(format!("{} cannot be read: {error}; {advice}", clean(file, 300)))
    };
    let mut opened = content_of(Path::new(file)).map_err(|error| unreadable(&error))?;
    let (mut hasher, mut buffer) = (Sm3Hasher::new(), vec![0; 256 * 1024]);
    loop {
        let read = opened.read(&mut buffer).map_err(|error| unreadable(&error))?;
        let bytes = buffer.get(..read).unwrap_or_default();
        if bytes.is_empty() {
            return Ok(Digest(hasher.finish()).to_hex().chars().take(TAG).collect());
        }
        hasher.update(bytes);
    }
}

fn text(view: &ErasureView) -> String {
    let topics = if view.topics.is_empty() { String::new() } else { format!(" of {}", view.topics.join(", ")) };
    let mut lines = vec![match (view.named, view.deleted) {
        (0, _) => format!("{} messages{topics}, {}, would be erased", view.records, ByteSize(view.bytes)),
        (named, true) => format!("{named} messages{topics} are erased"),
        (named, false) => {
            format!("{named} messages{topics} will be erased once that is confirmed on the chain")
        }
    }];
    let mut count = |count: u64, what: &str| {
        if count > 0 {
            lines.push(format!("{count} {what}"));
        }
    };
    count(view.waiting, "are not verified yet and stay; repeat this when they are");
    count(view.gone, "were deleted or erased earlier");
    count(view.other, "are quarantined, discarded or altered and stay");
    count(view.missing, "stay because their bytes are missing or altered; `authros audit --deep` names them");
    if !view.held.is_empty() {
        let names = view.held.join(", ");
        lines.push(format!("held by incidents: {names}; release them with `authros incident remove NAME --yes`"));
    }
    if view.named == 0 && view.records > 0 {
        lines.push("nothing was erased; --yes erases without asking".to_owned());
    }
    lines.push("digests, signatures, anchors and proofs stay; not reached:".to_owned());
    lines.extend(view.stays.iter().map(|what| format!("- {what}")));
    lines.join("\n")
}
