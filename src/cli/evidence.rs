//! `evidence`: `export`, and `verify` of a bundle: the meaning of the levels, for people.

use std::path::{Path, PathBuf};
use std::{fs::File, io::IsTerminal as _, io::Read as _};

use clap::{Args, Subcommand};

use super::connect::{Context, ProfileNeed};
use super::{args::Global, check, parse, plan::CHAIN};
use crate::crypto::{ProviderName, provider};
use crate::model::{Digest, ErrorKind, TopicPattern, clean, clean_lines, counted, grouped, natural};
use crate::ros::Limits;
use crate::ros::recording::{BESIDE, Beside};
use crate::service::command::{EvidenceWishes, ExportEvidence, StampEvidence};
use crate::service::reply::{EvidenceView, StampView};
use crate::service::{Client, Failure, definition_of, reply::input};
use authros_evidence::recorded::{RecordedFile, TAG};
use authros_evidence::{Bundle, LONGEST_TRUST, Outcome, RecordReport, Report, Standing, Trust};
use authros_output::{Output, table};

/// Typed to disclose what was counted.
const WORD: &str = "disclose";
const ALL: &str = "all";
const MOST_SHOWN: usize = 4000;

/// `evidence …`
#[derive(Debug, Subcommand)]
pub enum EvidenceVerb {
    /// Write your records and everything that proves them into one file for `evidence verify`; all records unless narrowed
    Export(ExportArguments),
    /// Check a bundle offline against --trust, or a folder of `records export` against --chain; needs no home, no keys
    Verify(VerifyArguments),
    /// Have `time.authorities` stamp everything not stamped yet, now; a running site does this every hour
    Timestamp,
}

/// `evidence export …`
#[derive(Debug, Args)]
pub struct ExportArguments {
    /// File to write, NAME.authros; must not exist
    pub file: PathBuf,
    /// Only this record, by id; repeatable
    #[arg(long = "record", value_name = "ID")]
    pub records: Vec<String>,
    /// Only this topic, or the topics that match this pattern; repeatable
    #[arg(long = "topic", value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// Only what this robot recorded, or the topics under its name
    #[arg(long, value_name = "NAME")]
    pub robot: Option<String>,
    /// Only this incident; its name, span and notes are included in the bundle's page
    #[arg(long, value_name = "NAME")]
    pub incident: Option<String>,
    /// Captured at or after: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub since: Option<String>,
    /// Captured before; same format
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub until: Option<String>,
    /// Disclose this record, by id, or 'all' that are chosen: anyone with the file can read topic, type and message,
    /// permanently, but nothing else of the topic; repeatable
    #[arg(long = "reveal", value_name = "ID|all")]
    pub reveal: Vec<String>,
    /// Disclose the chosen messages of this topic, or of all that match a pattern such as '/robot*/odom'; repeatable
    #[arg(long = "reveal-topic", value_name = "TOPIC")]
    pub reveal_topics: Vec<String>,
    /// Disclose without asking; without it, what would become readable is shown first
    #[arg(long)]
    pub yes: bool,
}

/// `evidence verify …`
#[derive(Debug, Args)]
pub struct VerifyArguments {
    /// The bundle, unpacked or not, or the folder
    pub path: PathBuf,
    /// For a bundle: what you know about chain, signers and people from an independent source (docs/reader.md)
    #[arg(long, value_name = "FILE", conflicts_with = "genesis")]
    pub trust: Option<PathBuf>,
    /// For the proof of a followed recording: the recorded file, to compare with the digests that the proof states
    #[arg(long, value_name = "FILE", conflicts_with = "genesis")]
    pub recording: Option<PathBuf>,
    /// Hash of the chain's block 0, from a source other than the folder
    #[arg(long, value_name = "HASH")]
    pub genesis: Option<String>,
    /// For a bundle: also list each record, by topic and time, with what its owner disclosed
    #[arg(long, conflicts_with = "genesis")]
    pub records: bool,
    /// For a bundle: as --records, with the reason of each level even where nothing is in doubt
    #[arg(long, conflicts_with = "genesis")]
    pub verbose: bool,
}

/// A check needs neither home nor settings.
pub async fn run(global: Global, verb: EvidenceVerb, output: &Output) -> Result<u8, Failure> {
    match verb {
        EvidenceVerb::Verify(arguments) => verify(&global, arguments, output).await,
        EvidenceVerb::Timestamp => stamp(Context::new(global, output)?, output).await,
        EvidenceVerb::Export(arguments) => {
            let (wishes, context) = (arguments.wishes(output)?, Context::new(global, output)?);
            let asks = !wishes.sure && !context.global.json && std::io::stdin().is_terminal();
            let export = async |client: &Client| export(client, wishes, asks, output).await;
            context.with(CHAIN, ProfileNeed::Unlocked, output, export).await
        }
    }
}

impl ExportArguments {
    fn wishes(self, output: &Output) -> Result<EvidenceWishes, Failure> {
        let Self { file, records, topics, robot, incident, since, until, mut reveal, reveal_topics, yes } = self;
        let chosen = reveal.len();
        reveal.retain(|id| id != ALL);
        let reveal_all = reveal.len() < chosen;
        let reveal_topics: Vec<TopicPattern> = parse::values(&reveal_topics)?;
        let file = parse::absolute(&file)?;
        let times = parse::Times::now(output);
        let (since, until) = (times.since(since.as_deref())?, times.until(until.as_deref())?);
        let (topics, incident) = (parse::values(&topics)?, parse::optional(incident.as_deref())?);
        // An id names what it discloses; a pattern has to be counted first.
        let sure = yes || (!reveal_all && reveal_topics.is_empty());
        Ok(EvidenceWishes {
            file,
            records,
            topics,
            robot,
            incident,
            since,
            until,
            reveal,
            reveal_topics,
            reveal_all,
            sure,
        })
    }
}

async fn verify(global: &Global, arguments: VerifyArguments, output: &Output) -> Result<u8, Failure> {
    let VerifyArguments { path, trust, recording, genesis, records, verbose } = arguments;
    let of_bundle = genesis.is_none() && (trust.is_some() || recording.is_some() || is_bundle(&path));
    match of_bundle {
        true => {
            let detail = Detail::of(records, verbose);
            verify_bundle((&path, recording.as_deref()), trust.as_deref(), detail, output)
        }
        false => check::verify_folder(global, &path, genesis.as_deref(), output).await,
    }
}

async fn export(client: &Client, wishes: EvidenceWishes, asks: bool, output: &Output) -> Result<u8, Failure> {
    let mut view = client.ask(ExportEvidence(wishes.clone())).await?;
    if !view.written && asks {
        output.note(&exported(&view));
        output.note(&format!("type '{WORD}' to write the file:"));
        if parse::typed(WORD) {
            view = client.ask(ExportEvidence(EvidenceWishes { sure: true, ..wishes })).await?;
        }
    }
    output.result(&view, || exported(&view));
    // Without a confirmation, a script must not take it for done.
    Ok(if view.written || asks { 0 } else { ErrorKind::Usage.exit_code() })
}

async fn stamp(context: Context, output: &Output) -> Result<u8, Failure> {
    let stamp = async |client: &Client| client.ask(StampEvidence).await;
    let view = context.with(CHAIN, ProfileNeed::None, output, stamp).await?;
    output.result(&view, || stamped(&view));
    Ok(if view.problem.is_some() { ErrorKind::Incomplete.exit_code() } else { 0 })
}

pub fn stamped(view: &StampView) -> String {
    let mut lines =
        vec![format!("{} stamped, {} pending", counted(view.roots, "batch"), counted(view.waiting, "stamp"))];
    lines.extend(view.tokens.iter().map(|token| {
        let (roots, before) = (counted(token.roots, "batch"), token.before);
        format!("{roots} existed before {before}, according to the stamp of {}", token.authority)
    }));
    lines.extend(view.problem.iter().map(|problem| format!("note: {problem}; it will be retried")));
    lines.join("\n")
}

pub fn exported(view: &EvidenceView) -> String {
    let EvidenceView { file, bytes, records, revealed, topics, written, notes } = view;
    let of_them = counted(*records, "record");
    let mut lines = match written {
        true => vec![format!("{of_them}, {} of them disclosed, in {file} (0600, {bytes} bytes)", grouped(*revealed))],
        false => vec![format!("{of_them} would go into {file}")],
    };
    if *revealed > 0 {
        let (readable, of) = (counted(*revealed, "record"), counted(topics.len() as u64, "topic"));
        let will = match (*written, *revealed) {
            (false, _) => "would be",
            (true, 1) => "is",
            (true, _) => "are",
        };
        lines.push(format!(
            "{readable} of {of} {will} readable to everybody who gets the file, and that cannot be undone:"
        ));
        lines.extend(topics.iter().map(|one| format!("  {} of {}", grouped(one.records), one.topic)));
    }
    lines.extend((!written).then(|| "nothing was written; --yes writes it without asking".to_owned()));
    lines.extend(notes.iter().map(|note| format!("note: {note}")));
    lines.join("\n")
}

/// How much `verify` prints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Detail {
    Verdict,
    Records,
    Reasons,
}

impl Detail {
    fn of(records: bool, verbose: bool) -> Self {
        match (records, verbose) {
            (_, true) => Self::Reasons,
            (true, false) => Self::Records,
            (false, false) => Self::Verdict,
        }
    }
}

fn is_bundle(path: &Path) -> bool {
    !path.is_dir() || path.join("manifest.json").exists()
}

fn verify_bundle(
    (path, recording): (&Path, Option<&Path>),
    trust: Option<&Path>,
    detail: Detail,
    output: &Output,
) -> Result<u8, Failure> {
    if !path.exists() {
        let advice = "give a bundle (NAME.authros) or a folder from `records export`";
        return Err(input(format!("{} does not exist; {advice}", path.display())));
    }
    let provider = provider(ProviderName::default());
    let trust = trust.map(read_trust).transpose()?;
    let failed = |error: authros_evidence::BundleError| {
        let text = format!("{}: {error}; nothing in it is shown, ask its exporter for another copy", path.display());
        Failure::new(ErrorKind::Tampered, text)
    };
    let bundle = Bundle::read(path, provider).map_err(failed)?;
    let report = authros_evidence::verify(&bundle, trust.as_ref(), provider);
    let recording = recording.map(|file| Recording::compare(&report, file)).transpose()?;
    output.result(&Shown { bundle: &bundle, report: &report, recording: recording.as_ref() }, || {
        let told = recording.as_ref().map_or_else(String::new, |recording| format!("\n{}", recording.text));
        text(&bundle, &report, detail) + &told
    });
    let compared = recording.map_or(Standing::Proven, |recording| recording.standing);
    Ok(match (report.outcome, compared) {
        (Outcome::Refused, _) | (_, Standing::Refused) => ErrorKind::Tampered.exit_code(),
        (Outcome::Incomplete, _) | (_, Standing::Absent) => ErrorKind::Incomplete.exit_code(),
        (Outcome::Holds, _) => 0,
    })
}

/// Unreadable pins are an error: without them it would look as if nothing were proven.
fn read_trust(path: &Path) -> Result<Trust, Failure> {
    let failed = |why: String| input(format!("{}: {why}", path.display()));
    let unread = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::NotFound => failed(
            "there is no such trust file, so the bundle was not checked; write what you know of its chain and its \
             people into one (docs/reader.md has an example), or leave out --trust to see what the bundle claims"
                .to_owned(),
        ),
        _ => failed(format!("the trust file cannot be read, so the bundle was not checked: {error}")),
    };
    // One byte more, so that a longer file is refused.
    let (mut bytes, most) = (Vec::new(), LONGEST_TRUST as u64 + 1);
    File::open(path).and_then(|file| file.take(most).read_to_end(&mut bytes)).map_err(unread)?;
    Trust::parse(&bytes).map_err(|error| failed(error.to_string()))
}

/// Builds the JSON only if JSON is requested.
struct Shown<'a> {
    bundle: &'a Bundle,
    report: &'a Report,
    recording: Option<&'a Recording>,
}

impl serde::Serialize for Shown<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut value = shown(self.bundle, self.report);
        if let (Some(recording), Some(object)) = (self.recording, value.as_object_mut()) {
            object.insert("recording".to_owned(), serde_json::to_value(recording).unwrap_or_default());
        }
        value.serialize(serializer)
    }
}

fn shown(bundle: &Bundle, report: &Report) -> serde_json::Value {
    let (mut value, mut limits) = (serde_json::to_value(report).unwrap_or_default(), Limits::default());
    let records = value.get_mut("records").and_then(serde_json::Value::as_array_mut);
    for (shown, record) in records.into_iter().flatten().zip(&report.records) {
        let disclosed = shown.get_mut("disclosed").and_then(serde_json::Value::as_object_mut);
        if let (Some(disclosed), Some(fields)) = (disclosed, message(bundle, report, record.digest, &mut limits)) {
            disclosed.insert("message".to_owned(), fields);
        }
    }
    value
}

/// `None` without its definition in the bundle, or beyond the limits of the whole file.
fn message(bundle: &Bundle, report: &Report, digest: Digest, limits: &mut Limits) -> Option<serde_json::Value> {
    let revealed = report.messages.get(&digest)?;
    let definition = definition_of(bundle, &revealed.head)?;
    let value = definition.decode_from(&revealed.body, limits).ok()?;
    Some(value.to_json())
}

/// A name counts only with its owner's key: anybody can write another's account into a header.
fn whose(record: &RecordReport) -> String {
    match (&record.person, record.owner) {
        (Some(person), Some(owner)) if record.is_believed() => format!("of {person} ({owner})"),
        (None, Some(owner)) if record.is_believed() => format!("of {owner}"),
        (_, Some(owner)) => format!("claimed owner {owner}"),
        (_, None) => "owner unreadable".to_owned(),
    }
}

fn bounded(fields: &serde_json::Value) -> String {
    let text = serde_json::to_string_pretty(fields).unwrap_or_default();
    let first: String = text.chars().take(MOST_SHOWN).collect();
    let more = if first.len() < text.len() { "\ntruncated; --json shows all" } else { "" };
    clean_lines(&first, MOST_SHOWN) + more
}

/// Nothing that every bundle has to prove is in doubt or contradicted.
fn is_whole(record: &RecordReport) -> bool {
    record.levels().iter().all(|(letter, level)| match level.standing {
        Standing::Proven | Standing::OwnChain | Standing::Absent => true,
        Standing::Unproven => *letter == 'd',
        Standing::Refused => false,
    })
}

/// The levels of a record, without reasons: `(a) (b) (c) proven, (d) not proven`.
fn standings(record: &RecordReport) -> String {
    let mut groups: Vec<(Standing, String)> = Vec::new();
    for (letter, level) in record.levels().iter().filter(|(_, level)| level.standing != Standing::Absent) {
        match groups.last_mut() {
            Some((standing, letters)) if *standing == level.standing => letters.push_str(&format!(" ({letter})")),
            _ => groups.push((level.standing, format!("({letter})"))),
        }
    }
    groups.iter().map(|(standing, letters)| format!("{letters} {}", standing.word())).collect::<Vec<_>>().join(", ")
}

fn about(record: &RecordReport, briefly: bool) -> Vec<String> {
    let who = format!("record {} {}", record.digest, whose(record));
    let when = record.seq.zip(record.captured_at).map(|(seq, captured)| {
        let gap = record.seconds_to_anchor.map_or(String::new(), |seconds| format!(", {seconds} s before its anchor"));
        format!("record no. {seq}, captured {captured} according to its owner{gap}")
    });
    if briefly {
        let when = when.map_or(String::new(), |when| format!(", {when}"));
        return vec![format!("{who}{when}: {}", standings(record))];
    }
    let row = |(letter, level): (char, &authros_evidence::Level)| {
        [format!("({letter})"), level.standing.word().to_owned(), clean(&level.text, 400)]
    };
    let levels = table(&["level", "", ""], record.levels().map(row));
    std::iter::once(who).chain(when).chain([levels]).collect()
}

fn topic(record: &RecordReport) -> &str {
    record.disclosed.as_ref().map_or("", |disclosed| &disclosed.topic)
}

fn text(bundle: &Bundle, report: &Report, detail: Detail) -> String {
    let mut lines = report.lines();
    if detail == Detail::Verdict {
        return lines.join("\n");
    }
    let mut limits = Limits::default();
    lines.push(String::new());
    let mut records: Vec<&RecordReport> = report.records.iter().collect();
    records.sort_by_key(|record| (record.topic_id, record.captured_at, record.seq));
    records.sort_by(|one, other| natural(topic(one), topic(other)));
    for record in records {
        let briefly = detail == Detail::Records && is_whole(record);
        lines.extend(about(record, briefly));
        if let Some(disclosed) = &record.disclosed {
            let (topic, type_name, length) = (&disclosed.topic, &disclosed.type_name, disclosed.length);
            lines.push(format!("'{topic}' {type_name}, {length} bytes, from {}", disclosed.publisher));
            let fields = message(bundle, report, record.digest, &mut limits);
            let unread =
                "its fields are not shown: the message's definition is not in the bundle, or the message is too large";
            lines.push(fields.map_or_else(|| unread.to_owned(), |fields| bounded(&fields)));
        }
        if !briefly {
            lines.push(String::new());
        }
    }
    for stretch in &report.complete {
        let (topic, recorder, word) = (stretch.topic_id, stretch.recorder, stretch.standing.word());
        lines.push(format!("(f) {word}: topic {topic} of recorder {recorder}: {}", stretch.text));
    }
    lines.push(report.exporter.text.clone());
    lines.extend(report.warnings.iter().map(|warning| format!("note: {warning}")));
    lines.join("\n")
}

// `verify --recording`: a recorded file beside the bundle that states its digests.

const MOST_NAMED: usize = 100;

#[derive(Debug, serde::Serialize)]
pub struct Recording {
    /// `refused` if the file differs, `absent` if the bundle states nothing of a file.
    pub standing: Standing,
    pub record: Option<Digest>,
    pub name: Option<String>,
    pub bytes: u64,
    pub chunks: u64,
    /// Offsets of the chunks that differ; the first 100.
    pub differing: Vec<u64>,
    pub text: String,
}

impl Recording {
    pub fn compare(report: &Report, path: &Path) -> Result<Self, Failure> {
        let failed = |error: std::io::Error| Failure::new(ErrorKind::Input, format!("{}: {error}", path.display()));
        let mut worst = None;
        for (digest, stated) in statements(report) {
            let compared = stated.compare(File::open(path).map_err(failed)?).map_err(failed)?;
            let one = Self::of(digest, &stated, compared);
            if one.standing == Standing::Proven {
                return Ok(one);
            }
            worst = worst.or(Some(one));
        }
        let bytes = std::fs::metadata(path).map_err(failed)?.len();
        let text = "the bundle states nothing about a recorded file to compare with".to_owned();
        let (standing, differing) = (Standing::Absent, Vec::new());
        let none = Self { standing, record: None, name: None, bytes, chunks: 0, differing, text };
        Ok(worst.unwrap_or(none))
    }

    fn of(record: Digest, stated: &RecordedFile, compared: authros_evidence::recorded::Compared) -> Self {
        let (name, chunks, differing) =
            (clean(&stated.name, 300), counted(compared.chunks, "chunk"), compared.differing.len());
        let text = match (compared.is_whole, compared.differing.first()) {
            (true, _) => format!("the recording is '{name}' as record {record} states it: all {} bytes", stated.length),
            (false, Some(first)) => format!(
                "the recording DIFFERS from '{name}' as record {record} states it: {differing} of {chunks}, the \
                 first at byte {first}; the proof holds for the file as it was, of which there may be a copy"
            ),
            (false, None) => format!(
                "the recording DIFFERS from '{name}' as record {record} states it, though not in its {chunks}: it \
                 has {} bytes, and had {}; the proof holds for the file as it was, of which there may be a copy",
                compared.length, stated.length
            ),
        };
        let standing = if compared.is_whole { Standing::Proven } else { Standing::Refused };
        let differing = compared.differing.into_iter().take(MOST_NAMED).collect();
        Self {
            standing,
            record: Some(record),
            name: Some(name),
            bytes: compared.length,
            chunks: compared.chunks,
            differing,
            text,
        }
    }
}

/// Statements about files in records that are opened and signed.
fn statements(report: &Report) -> impl Iterator<Item = (Digest, RecordedFile)> {
    let opened = report.records.iter().filter(|record| {
        let is_open = matches!(record.opened.standing, Standing::Proven | Standing::OwnChain | Standing::Unproven);
        let is_statement = record.disclosed.as_ref().is_some_and(|told| {
            let is_tagged = told.tags.get(TAG.0).is_some_and(|value| value == TAG.1);
            is_tagged && told.topic == BESIDE && told.type_name == Beside::Metadata.type_name()
        });
        is_open && is_statement && record.bytes.standing == Standing::Proven
    });
    opened.filter_map(|record| {
        let revealed = report.messages.get(&record.digest)?;
        RecordedFile::parse(&revealed.body).map(|stated| (record.digest, stated))
    })
}

#[cfg(test)]
mod tests {
    use authros_evidence::Level;

    use super::*;
    use crate::model::Timestamp;

    fn record(number: u8, key: Standing) -> RecordReport {
        let level = |standing| Level::new(standing, "why");
        RecordReport {
            digest: Digest([number; 32]),
            owner: None,
            person: None,
            signer: None,
            owner_key: None,
            recorder: None,
            topic_id: None,
            seq: None,
            captured_at: Some(Timestamp::from_seconds(1)),
            anchored_at: None,
            block: None,
            seconds_to_anchor: None,
            existed_before: None,
            authority: None,
            bytes: level(Standing::Proven),
            key: level(key),
            anchor: level(Standing::OwnChain),
            time: level(Standing::Absent),
            opened: level(Standing::Absent),
            disclosed: None,
        }
    }

    #[test]
    fn a_whole_record_is_a_line_and_one_in_doubt_tells_its_reasons() {
        let whole = record(1, Standing::OwnChain);
        assert!(is_whole(&whole));
        let told = about(&whole, true);
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].ends_with("owner unreadable: (a) proven, (b) (c) self-sealed chain"), "{told:?}");
        assert!(about(&whole, false).concat().contains("why"));
        let level = |standing| Level::new(standing, "why");
        assert!(is_whole(&RecordReport { time: level(Standing::Unproven), ..whole.clone() }), "nobody was pinned");
        for doubtful in [
            record(2, Standing::Unproven),
            RecordReport { opened: level(Standing::Unproven), ..whole.clone() },
            RecordReport { time: level(Standing::Refused), ..whole },
        ] {
            assert!(!is_whole(&doubtful));
        }
    }

    #[test]
    fn a_trust_file_that_is_not_there_is_told_apart_from_one_that_is_none() {
        let folder = tempfile::tempdir().expect("a folder");
        let place = folder.path().join("trust.toml");
        let missing = read_trust(&place).expect_err("missing");
        assert!(
            missing.kind == ErrorKind::Input && missing.message.contains("there is no such trust file"),
            "{missing}"
        );
        std::fs::write(&place, "chain = 1").expect("written");
        let wrong = read_trust(&place).expect_err("none");
        assert!(wrong.message.contains("the trust file cannot be used"), "{wrong}");
        std::fs::write(&place, vec![b'#'; LONGEST_TRUST + 10]).expect("written");
        assert!(read_trust(&place).expect_err("long").message.contains("too long"));
        assert!(read_trust(folder.path()).expect_err("a folder").message.contains("cannot be read"));
    }
}
