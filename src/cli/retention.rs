//! `records erase`: chosen records; what rules delete is decided by the settings.

use std::io::{IsTerminal as _, Read as _};
use std::path::Path;

use clap::Args;

use super::connect::{Context, ProfileNeed};
use super::{parse, plan::CHAIN};
use crate::model::{ByteSize, Digest, ErrorKind, clean, counted};
use crate::service::command::{EraseRecords, ErasureWishes};
use crate::service::{Client, Failure, reply::ErasureView, reply::input};
use crate::{crypto::Sm3Hasher, ros::recording::content_of};
use authros_output::Output;

const WORD: &str = "erase";
/// Topics named one by one.
const MOST_LISTED: usize = 20;
/// Characters of an imported file's tag.
const TAG: usize = 16;

/// `records erase …`
#[derive(Debug, Args)]
pub struct EraseArguments {
    /// Messages of this topic, or of the topics that match this pattern
    #[arg(long, required_unless_present_any = ["records", "recording", "robot"])]
    pub topic: Option<String>,
    /// Messages of this robot: as enrolled, or the first part of its topics, as robot1 for /robot1/odom
    #[arg(long, value_name = "NAME")]
    pub robot: Option<String>,
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
    #[arg(conflicts_with_all = ["topic", "robot", "recording", "since", "until"])]
    pub records: Vec<String>,
    /// Why; shown with the records from then on
    #[arg(long, value_name = "TEXT")]
    pub reason: String,
    /// Erase without asking; without it, what would go is shown
    #[arg(long)]
    pub yes: bool,
}

pub async fn run(context: Context, arguments: EraseArguments, output: &Output) -> Result<u8, Failure> {
    let EraseArguments { topic, robot, recording, since, until, records, reason, yes } = arguments;
    let topic = parse::optional(topic.as_deref())?;
    let times = parse::Times::now(output);
    let (since, until) = (times.since(since.as_deref())?, times.until(until.as_deref())?);
    let recording = recording.as_deref().map(tag_of).transpose()?;
    let wishes = ErasureWishes { topic, robot, since, until, records, recording, reason, sure: yes, shown: None };
    let asks = !yes && !context.global.json && std::io::stdin().is_terminal();
    let erase = async |client: &Client| erase(client, wishes, asks, output).await;
    context.with(CHAIN, ProfileNeed::Unlocked, output, erase).await
}

async fn erase(client: &Client, wishes: ErasureWishes, asks: bool, output: &Output) -> Result<u8, Failure> {
    let sure = wishes.sure;
    let view = client.ask(EraseRecords(wishes.clone())).await?;
    if view.records + view.named + view.waiting + view.gone + view.other + view.missing == 0 {
        let what = "no message of yours has that topic, robot and time; `authros records list` shows yours";
        return Err(input(format!("nothing matches: {what}")));
    }
    let is_sure = asks && view.records > 0 && view.held.is_empty() && {
        output.note(&text(&view));
        output.note(&format!("type '{WORD}' to erase {} permanently:", chosen(view.records, &view)));
        parse::typed(WORD)
    };
    let shown = Some(view.records);
    let view =
        if is_sure { client.ask(EraseRecords(ErasureWishes { sure: true, shown, ..wishes })).await? } else { view };
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

/// `8,505 records of 12 topics`.
fn chosen(records: u64, view: &ErasureView) -> String {
    format!("{} of {}", counted(records, "record"), counted(view.topics.len() as u64, "topic"))
}

fn text(view: &ErasureView) -> String {
    let mut lines = vec![match (view.named, view.deleted) {
        (0, _) => format!("would be erased: {}, {}", chosen(view.records, view), ByteSize(view.bytes)),
        (named, true) => format!("erased: {}", chosen(named, view)),
        (named, false) => format!("erased once that is confirmed on the chain: {}", chosen(named, view)),
    }];
    lines.extend(view.topics.iter().take(MOST_LISTED).map(|topic| format!("- {topic}")));
    if view.topics.len() > MOST_LISTED {
        lines.push(format!(
            "- and {}; --json lists all",
            counted((view.topics.len() - MOST_LISTED) as u64, "more topic")
        ));
    }
    let mut count = |count: u64, what: &str| {
        if count > 0 {
            lines.push(format!("{} {what}", counted(count, "record")));
        }
    };
    count(view.waiting, "not verified yet, kept; repeat this later");
    count(view.gone, "deleted or erased earlier");
    count(view.other, "quarantined, discarded or altered, kept");
    count(view.missing, "kept, with the bytes missing or altered; see `authros audit --deep`");
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_go_and_what_went_name_how_many_records_of_how_many_topics() {
        let topics = (0..23).map(|number| format!("/robot{number}/odom")).collect();
        let view = ErasureView { records: 8_505, bytes: 2048, topics, ..ErasureView::default() };
        let told = text(&view);
        let lines: Vec<&str> = told.lines().collect();
        assert_eq!(lines[..2], ["would be erased: 8,505 records of 23 topics, 2 KiB", "- /robot0/odom"]);
        assert_eq!(lines[20..22], ["- /robot19/odom", "- and 3 more topics; --json lists all"]);
        assert!(told.contains("nothing was erased; --yes erases without asking"), "{told}");
        let one = ErasureView { named: 1, deleted: true, topics: vec!["/odom".to_owned()], ..view };
        assert!(text(&one).starts_with("erased: 1 record of 1 topic\n- /odom\n"), "{}", text(&one));
        let later = text(&ErasureView { deleted: false, ..one });
        assert!(later.starts_with("erased once that is confirmed on the chain: 1 record of 1 topic\n"), "{later}");
    }

    #[test]
    fn a_pattern_or_a_robot_chooses_and_records_by_id_go_alone() {
        use clap::Parser;
        let parsed = |more: &[&str]| {
            let words = [&["authros", "records", "erase", "--reason", "asked"], more].concat();
            super::super::args::Arguments::try_parse_from(words).is_ok()
        };
        assert!(parsed(&["--topic", "/robot*/camera/**"]) && parsed(&["--robot", "scout-1", "--since", "1h"]));
        assert!(parsed(&["--topic", "/odom", "--robot", "scout-1"]) && parsed(&["--record", "0a"]));
        assert!(!parsed(&[]) && !parsed(&["--since", "1h"]) && !parsed(&["--record", "0a", "--robot", "scout-1"]));
    }
}
