//! `report.html` of a bundle: page one in the sentences of the verdict, then what is disclosed, then tables. It proves
//! nothing and says so; no scripts, no requests, every text cleaned and escaped.

macro_rules! put {
    ($out:expr, $($text:tt)+) => {
        put($out, format_args!($($text)+))
    };
}

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use authros_evidence::{Bundle, RecordReport, Report, Standing};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use crate::model::{Digest, Head, SignerId, Timestamp, TopicId, clean, counted, grouped};
use crate::pipeline::importer;
use crate::reply::IncidentView;
use crate::ros::message::{Folders, type_hash};
use crate::ros::readable::{self, Place, Plot, Readable};
use crate::ros::recording::{Described, TYPE_HASH, TypeFacts};
use crate::ros::{Definition, Limits};

const MOST_ROWS: usize = 200;
const MOST_TOPICS: usize = 20;
/// Records of a topic whose values are drawn.
const MOST_DRAWN: usize = 400;
/// Records of a topic whose values are listed.
const MOST_LISTED: usize = 12;
const MOST_PICTURES: usize = 6;
/// Columns of values.
const MOST_COLUMNS: usize = 4;
/// Size from which disclosed topics are left out, bytes.
const LONGEST: usize = 8 << 20;
const MOST_FIELDS: usize = 200;
const WIDEST: usize = 1000;
/// Characters of a short digest.
const SHORT: usize = 12;

const HEAD: &str = include_str!("page/head.html");

const MARK: &str = "<p class=\"mark\"><b>This page proves nothing.</b> The program of the person who made the file wrote it, \
    with that program's own trust settings. Check the file: drop it on <code>verify.html</code> in a browser, or run \
    <code>authros evidence verify FILE.authros --trust trust.toml</code>, with a trust file of your own.</p>\n";

pub(super) fn escape(text: &str) -> String {
    let text = clean(text, WIDEST).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    text.replace('"', "&quot;").replace('\'', "&#39;")
}

fn put(out: &mut String, text: std::fmt::Arguments<'_>) {
    let _infallible = out.write_fmt(text);
}

fn row<'a>(out: &mut String, cell: &str, cells: impl IntoIterator<Item = &'a str>) {
    out.push_str("<tr>");
    // The name of a field may be broken behind its dots.
    let shown = |text: &str| if cell == "th" { escape(text).replace('.', ".<wbr>") } else { escape(text) };
    cells.into_iter().for_each(|text| put!(out, "<{cell}>{}</{cell}>", shown(text)));
    out.push_str("</tr>\n");
}

fn table(out: &mut String, class: &str, head: &[&str], rows: &[Vec<String>]) {
    put!(out, "<table class=\"{class}\">\n");
    if !head.is_empty() {
        out.push_str("<thead>");
        row(out, "th", head.iter().copied());
        out.push_str("</thead>\n");
    }
    rows.iter().for_each(|cells| row(out, "td", cells.iter().map(String::as_str)));
    out.push_str("</table>\n");
}

fn facts(out: &mut String, rows: &[Vec<String>]) {
    table(out, "facts", &[], rows);
}

fn fact(name: impl Into<String>, value: impl Into<String>) -> Vec<String> {
    vec![name.into(), value.into()]
}

fn short(hex: &str) -> String {
    hex.chars().take(SHORT).collect()
}

fn count(number: usize) -> String {
    grouped(number as u64)
}

/// `2026-11-22 03:43:21.549`, for columns.
fn moment(at: Timestamp) -> String {
    at.in_milliseconds().replace('T', " ").replace('Z', "")
}

pub(super) fn page(bundle: &Bundle, report: &Report, about: Option<&IncidentView>) -> String {
    let mut out = format!("{HEAD}<h1>Evidence report</h1>\n{MARK}");
    first_page(&mut out, report, about);
    let notes: Vec<Timestamp> = about.iter().flat_map(|about| &about.notes).map(|note| note.at).collect();
    disclosed(&mut out, bundle, report, &notes);
    let is_in_doubt = |record: &RecordReport| {
        record.levels().iter().any(|(_, level)| matches!(level.standing, Standing::Unproven | Standing::Refused))
    };
    let mut sorted: Vec<&RecordReport> = report.records.iter().collect();
    sorted.sort_by_key(|record| (!is_in_doubt(record), record.captured_at, record.seq, record.digest));
    let listed = sorted.get(..MOST_ROWS).unwrap_or(sorted.as_slice());
    records(&mut out, report, listed);
    completeness(&mut out, report);
    appendix(&mut out, bundle, report, listed);
    out.push_str("</body>\n</html>\n");
    out
}

/// What, who, when, by whose proof, and what is not proven.
fn first_page(out: &mut String, report: &Report, about: Option<&IncidentView>) {
    out.push_str("<section class=\"first\">\n");
    if let Some(about) = about {
        incident(out, about);
    }
    out.push_str(
        "<h2>Result, by the exporter's own trust settings</h2>\n<p class=\"small\">\u{201c}You\u{201d} is the person who made \
         the file; <code>verify.html</code> says the same sentences to you, by your trust file.</p>\n",
    );
    let (outcome, sentences) =
        report.verdict.split_first().map_or(("", &[][..]), |(first, rest)| (first.as_str(), rest));
    put!(out, "<p class=\"outcome\">{}</p>\n<ul>\n", escape(outcome));
    sentences.iter().for_each(|sentence| put!(out, "<li>{}</li>\n", escape(sentence)));
    out.push_str(
        "</ul>\n<p class=\"small\">The levels mean: (a) the bytes are intact and signed; (b) the key was its owner's at the anchoring \
         block; (c) anchored in a block; (d) an outside authority's time; (e) opened by its owner's disclosure; (f) which \
         numbers are there.</p>\n</section>\n",
    );
}

fn incident(out: &mut String, about: &IncidentView) {
    out.push_str("<h2>Incident, in its owner's words</h2>\n");
    let until = about.until.map_or_else(|| "still open".to_owned(), Timestamp::in_utc);
    let mut rows = vec![fact("Name", about.name.to_string()), fact("From", about.since.in_utc()), fact("To", until)];
    rows.extend(about.notes.iter().map(|note| fact(format!("Note, {}", note.at.in_utc()), &*note.text)));
    facts(out, &rows);
}

/// The disclosed records by topic; what recorders state of themselves is reported under (f).
fn by_topic(report: &Report) -> BTreeMap<&str, Vec<&RecordReport>> {
    let mut topics: BTreeMap<&str, Vec<&RecordReport>> = BTreeMap::new();
    for record in report.records.iter().filter(|record| !record.is_statement()) {
        if let Some(disclosed) = &record.disclosed {
            topics.entry(&disclosed.topic).or_default().push(record);
        }
    }
    topics.values_mut().for_each(|records| records.sort_by_key(|record| (record.captured_at, record.seq)));
    topics
}

fn disclosed(out: &mut String, bundle: &Bundle, report: &Report, notes: &[Timestamp]) {
    let topics = by_topic(report);
    out.push_str("<h2>Disclosed records</h2>\n");
    if topics.is_empty() {
        out.push_str("<p>None: every message in the file is sealed, except recorders' own statements.</p>\n");
        return;
    }
    let times = topics.iter().take(MOST_TOPICS).map(|(topic, records)| {
        (clean(topic, 40), records.iter().filter_map(|record| record.captured_at).collect::<Vec<_>>())
    });
    timeline(out, &times.collect::<Vec<_>>(), notes);
    for (place, (topic, records)) in topics.iter().enumerate() {
        if place == MOST_TOPICS || out.len() > LONGEST {
            put!(out, "<p>and {}, not shown here</p>\n", counted((topics.len() - place) as u64, "more topic"));
            return;
        }
        one_topic(out, (bundle, report), topic, records);
    }
}

/// Evenly spread, the first and the last among them.
fn spread<'a>(records: &[&'a RecordReport], most: usize) -> Vec<&'a RecordReport> {
    let steps = most.min(records.len());
    let last = records.len().saturating_sub(1);
    let place = |step: usize| (step * last).checked_div(steps.saturating_sub(1)).unwrap_or_default();
    (0..steps).filter_map(|step| records.get(place(step)).copied()).collect()
}

fn one_topic(out: &mut String, (bundle, report): (&Bundle, &Report), topic: &str, records: &[&RecordReport]) {
    let opened = || records.iter().filter_map(|record| record.disclosed.as_ref());
    let types: BTreeSet<&str> = opened().map(|disclosed| disclosed.type_name.as_str()).collect();
    let publishers: BTreeSet<&str> = opened().map(|disclosed| disclosed.publisher.as_str()).take(MOST_ROWS).collect();
    let types = types.into_iter().collect::<Vec<_>>().join(", ");
    put!(out, "<section>\n<h3>{} <code>{}</code></h3>\n", escape(topic), escape(&types));
    let times = || records.iter().filter_map(|record| record.captured_at);
    let span = times()
        .min()
        .zip(times().max())
        .map_or_else(String::new, |(first, last)| format!("{} to {} UTC", moment(first), moment(last)));
    facts(
        out,
        &[
            fact("Records", count(records.len())),
            fact("Captured, as their owner claims", span),
            fact("Published by", publishers.into_iter().collect::<Vec<_>>().join(", ")),
        ],
    );
    let drawn = Drawn::of((bundle, report), records);
    drawn.put(out);
    if let Some(first) = records.first() {
        let (digest, number) = (short(&first.digest.to_hex()), grouped(first.seq.unwrap_or_default()));
        put!(out, "<h4>The first of them in full: no. {number}, <code>{digest}</code></h4>\n");
        let tags = first.disclosed.iter().flat_map(|disclosed| &disclosed.tags);
        let tags: Vec<_> = tags.map(|(name, value)| fact(format!("Tag {name}"), &**value)).collect();
        if !tags.is_empty() {
            facts(out, &tags);
        }
        message(out, bundle, report, first, &mut Limits::default());
    }
    out.push_str("</section>\n");
}

/// Path or label, and text.
type Field = (String, String);

/// One message: when, its number, and each plain field as text.
struct Sample {
    at: Timestamp,
    number: u64,
    fields: Vec<Field>,
    /// As people read it, if its row is listed and its type is a well-known one.
    lines: Vec<Field>,
}

fn field<'a>(fields: &'a [Field], name: &str) -> Option<&'a str> {
    fields.iter().find(|(path, _)| path == name).map(|(_, text)| text.as_str())
}

/// Numbers of many digits, rounded for the eye.
fn rounded(text: &str) -> String {
    let number = text.parse::<f64>().ok().filter(|number| text.len() > 9 && (0.001..1e6).contains(&number.abs()));
    number.map_or_else(|| text.to_owned(), |number| format!("{number:.4}"))
}

/// What a topic's messages show together.
struct Drawn {
    places: Vec<Place>,
    samples: Vec<Sample>,
    /// Places in `samples` of those that are listed.
    listed: Vec<usize>,
    /// When, and the picture as PNG.
    pictures: Vec<(Timestamp, Vec<u8>)>,
}

impl Drawn {
    fn of((bundle, report): (&Bundle, &Report), records: &[&RecordReport]) -> Self {
        let mut drawn = Self { places: Vec::new(), samples: Vec::new(), listed: Vec::new(), pictures: Vec::new() };
        let mut limits = Limits::default();
        let chosen = spread(records, MOST_DRAWN);
        let some =
            |most: usize| -> BTreeSet<Digest> { spread(&chosen, most).iter().map(|record| record.digest).collect() };
        let (pictured, listed) = (some(MOST_PICTURES), some(MOST_LISTED));
        for record in &chosen {
            let Some(revealed) = report.messages.get(&record.digest) else { continue };
            let Some(definition) = definition_of(bundle, &revealed.head) else { continue };
            let (at, number) = (record.captured_at.unwrap_or_default(), record.seq.unwrap_or_default());
            drawn.places.extend(readable::place(&definition, &revealed.body));
            let (is_pictured, is_listed) = (pictured.contains(&record.digest), listed.contains(&record.digest));
            let is_read = is_pictured || is_listed;
            let readable = is_read.then(|| readable::read(&definition, &revealed.body)).flatten().unwrap_or_default();
            let picture = readable.picture.filter(|_| is_pictured);
            drawn.pictures.extend(picture.and_then(|raster| raster.png().ok()).map(|png| (at, png)));
            if let Ok(value) = definition.decode_from(&revealed.body, &mut limits) {
                drawn.listed.extend(is_listed.then_some(drawn.samples.len()));
                let (fields, lines) = (value.flatten(MOST_FIELDS), readable.lines);
                drawn.samples.push(Sample { at, number, fields, lines });
            }
        }
        drawn
    }

    fn put(&self, out: &mut String) {
        if self.pictures.len() > 1 {
            out.push_str("<div class=\"pictures\">\n");
            for (at, png) in &self.pictures {
                let uri = data_uri(png);
                let when = moment(*at);
                put!(out, "<figure><img alt=\"a picture, reduced\" src=\"{uri}\"><p>{when} UTC</p></figure>\n");
            }
            out.push_str("</div>\n");
        }
        let all: Vec<&[Field]> = self.samples.iter().map(|one| one.fields.as_slice()).collect();
        match readable::track("Track", &self.places, None).filter(|_| self.places.len() > 1) {
            Some(track) => plot(out, &track),
            None => {
                let names = changing(&all);
                names.iter().filter_map(|name| series(name, &self.numbers(name))).for_each(|one| plot(out, &one));
            }
        }
        // The sizes of pictures say nothing.
        if self.pictures.len() < 2 {
            self.values(out);
        }
    }

    fn values(&self, out: &mut String) {
        let listed: Vec<&Sample> = self.listed.iter().filter_map(|place| self.samples.get(*place)).collect();
        let is_readable = listed.iter().all(|one| !one.lines.is_empty());
        let fields: Vec<&[Field]> =
            listed.iter().map(|one| if is_readable { one.lines.as_slice() } else { one.fields.as_slice() }).collect();
        let columns = changing(&fields);
        if listed.len() < 2 || columns.is_empty() {
            return;
        }
        let rows = listed.iter().zip(&fields).map(|(one, fields)| {
            let value = |name: &&str| field(fields, name).map_or_else(|| "-".to_owned(), rounded);
            let first = [moment(one.at), grouped(one.number)];
            first.into_iter().chain(columns.iter().map(value)).collect()
        });
        let head: Vec<&str> = ["captured (UTC)", "number"].into_iter().chain(columns.iter().copied()).collect();
        table(out, "plain values", &head, &rows.collect::<Vec<Vec<String>>>());
    }

    fn numbers(&self, name: &str) -> Vec<(Timestamp, f64)> {
        self.samples.iter().filter_map(|one| Some((one.at, field(&one.fields, name)?.parse().ok()?))).collect()
    }
}

/// The first fields that change, short ones alone; neither stamps nor the lengths of arrays.
fn changing<'a>(samples: &[&'a [Field]]) -> Vec<&'a str> {
    let Some(first) = samples.first() else { return Vec::new() };
    let changes = |name: &str, text: &str| samples.iter().any(|one| field(one, name).is_some_and(|now| now != text));
    let is_clock = |name: &str| name.starts_with("header.") || name.starts_with("Stamp");
    let is_short = |name: &str, text: &str| text.chars().count() <= 48 && name.chars().count() <= 40;
    let fitting = first
        .iter()
        .filter(|(name, text)| is_short(name, text) && !text.ends_with(']') && !is_clock(name) && changes(name, text));
    fitting.take(MOST_COLUMNS).map(|(name, _)| name.as_str()).collect()
}

fn records(out: &mut String, report: &Report, listed: &[&RecordReport]) {
    out.push_str(
        "<h2>Records</h2>\n<p>Those in doubt first, then by time. Short digests; the appendix has them in full.</p>\n",
    );
    let rows: Vec<Vec<String>> = listed.iter().map(|record| level_row(record)).collect();
    table(
        out,
        "levels",
        &["record", "topic", "no.", "captured (UTC)", "block", "(a)", "(b)", "(c)", "(d)", "(e)"],
        &rows,
    );
    if let Some(more) = report.records.len().checked_sub(MOST_ROWS).filter(|more| *more > 0) {
        let text = "more records; <code>authros evidence verify FILE.authros --records</code> lists all of them";
        put!(out, "<p>and {} {text}</p>\n", count(more));
    }
}

fn level_row(record: &RecordReport) -> Vec<String> {
    let text = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
    let sealed =
        || record.topic_id.map(|topic| format!("sealed {}", topic.to_hex().chars().take(8).collect::<String>()));
    let topic = record.disclosed.as_ref().map(|disclosed| clean(&disclosed.topic, 40));
    let mut cells = vec![
        short(&record.digest.to_hex()),
        text(topic.or_else(sealed)),
        text(record.seq.map(grouped)),
        text(record.captured_at.map(moment)),
        text(record.block.map(grouped)),
    ];
    cells.extend(record.levels().map(|(_, level)| level.standing.word().to_owned()));
    cells
}

fn completeness(out: &mut String, report: &Report) {
    out.push_str("<h2>Which numbers are there (f)</h2>\n");
    let named = report
        .records
        .iter()
        .filter_map(|record| Some(((record.signer?, record.topic_id?), clean(&record.disclosed.as_ref()?.topic, 40))));
    let names: BTreeMap<(SignerId, TopicId), String> = named.collect();
    let stretches = report.complete.iter().take(MOST_ROWS);
    let rows: Vec<Vec<String>> = stretches
        .map(|one| {
            let sealed = || format!("sealed {}", short(&one.topic_id.to_hex()));
            let topic = names.get(&(one.signer, one.topic_id)).cloned().unwrap_or_else(sealed);
            vec![topic, short(&one.recorder.to_string()), one.standing.word().to_owned(), one.text.clone()]
        })
        .collect();
    table(out, "plain numbers", &["topic", "recorder", "result", "what is present"], &rows);
}

fn appendix(out: &mut String, bundle: &Bundle, report: &Report, listed: &[&RecordReport]) {
    let (chain, exporter) = (&bundle.manifest.chain, &bundle.manifest.exporter);
    out.push_str("<h2>Appendix</h2>\n");
    facts(
        out,
        &[
            fact("Exporter", format!("{}: {}", exporter.account, report.exporter.text)),
            fact("Exporter's key", exporter.key.to_string()),
            fact("Chain", format!("id {}, genesis {}, contract {}", chain.id, chain.genesis, chain.contract)),
        ],
    );
    out.push_str("<ul>\n");
    report.warnings.iter().for_each(|text| put!(out, "<li>{}</li>\n", escape(text)));
    out.push_str("</ul>\n<h3>Digests (SM3) in full, in the order of the table</h3>\n<p class=\"digests\">");
    listed.iter().for_each(|record| put!(out, "<code>{}</code>\n", record.digest));
    let by_hand: String = authros_evidence::READ_ME_TEXT.lines().map(|line| escape(line) + "\n").collect();
    put!(out, "</p>\n<h3>Check it manually</h3>\n<pre>{by_hand}</pre>\n");
}

/// The one that the head names, or one with the type's hash, stored or built in.
pub fn definition_of(bundle: &Bundle, head: &Head) -> Option<Arc<Definition>> {
    let about = importer::about(&head.tags);
    let (hash, encoding) = (about.get(TYPE_HASH).map(|hash| &**hash), importer::encoding(&head.tags));
    let has_hash = |text: &&String| hash.is_some() && type_hash(&head.type_name, text).ok().as_deref() == hash;
    let named = bundle.definitions.get(&head.definition).filter(|text| !text.is_empty());
    let text = named.or_else(|| bundle.definitions.values().find(has_hash)).map(String::as_str);
    // Nothing would show that a built-in one is the message's.
    text.or(hash)?;
    let facts = TypeFacts { name: &head.type_name, encoding, text, hash, md5sum: &head.md5sum };
    Described::of(facts, &Folders::default()).definition
}

fn message(out: &mut String, bundle: &Bundle, report: &Report, record: &RecordReport, limits: &mut Limits) {
    let Some(revealed) = report.messages.get(&record.digest) else { return };
    let Some(definition) = definition_of(bundle, &revealed.head) else {
        out.push_str("<p>Its fields are not shown: its definition is not in the file.</p>\n");
        return;
    };
    if let Some(readable) = readable::read(&definition, &revealed.body) {
        return easy(out, &readable);
    }
    let Ok(value) = definition.decode_from(&revealed.body, limits) else {
        out.push_str("<p>Its fields are not shown: they do not fit the definition, or there are too many.</p>\n");
        return;
    };
    let rows: Vec<_> = value.flatten(MOST_FIELDS).into_iter().map(|(path, text)| fact(path, text)).collect();
    table(out, "plain", &["field", "value"], &rows);
}

fn easy(out: &mut String, readable: &Readable) {
    let lines: Vec<_> = readable.lines.iter().map(|(label, value)| fact(&**label, &**value)).collect();
    facts(out, &lines);
    for shown in &readable.tables {
        put!(out, "<p class=\"title\">{}</p>\n", escape(&shown.title));
        let head: Vec<&str> = shown.head.iter().map(String::as_str).collect();
        table(out, "plain", &head, &shown.rows);
    }
    if let Some(shown) = &readable.plot {
        plot(out, shown);
    }
    if let Some(png) = readable.picture.as_ref().and_then(|raster| raster.png().ok()) {
        put!(out, "<p><img alt=\"the picture, reduced\" src=\"{}\"></p>\n", data_uri(&png));
    }
}

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 340.0;
/// Above the plot, and on its right.
const EDGE: f64 = 24.0;
/// On the left of the plot, with figures.
const LEFT: f64 = 80.0;
/// Below it, with figures.
const FOOT: f64 = 44.0;

pub(super) fn data_uri(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", STANDARD.encode(png))
}

fn finite(points: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> {
    points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite() && x.abs() < 1e12 && y.abs() < 1e12)
}

fn ends(numbers: impl Iterator<Item = f64>) -> (f64, f64) {
    let (least, most) = numbers.fold((f64::MAX, f64::MIN), |(least, most), one| (least.min(one), most.max(one)));
    if most > least { (least, most) } else { (least - 1.0, least + 1.0) }
}

/// A span of this length with the same middle.
fn around((least, most): (f64, f64), length: f64) -> (f64, f64) {
    let middle = f64::midpoint(least, most);
    (middle - length / 2.0, middle + length / 2.0)
}

/// To a thousandth, as short as that can be.
fn figure(number: f64) -> String {
    format!("{number:.3}").trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Places in metres: a metre is as long on both axes, and a path has a start and an end.
fn is_map(axes: &(String, String)) -> bool {
    axes.0.ends_with(", m") && axes.1.ends_with(", m")
}

/// What a plot spans, across and up.
struct Frame {
    x: (f64, f64),
    y: (f64, f64),
}

impl Frame {
    fn of(points: &[(f64, f64)], axes: &(String, String)) -> Self {
        let (wide, high) = (WIDTH - LEFT - EDGE, HEIGHT - FOOT - EDGE);
        let (x, y) = (ends(points.iter().map(|point| point.0)), ends(points.iter().map(|point| point.1)));
        if !is_map(axes) {
            return Self { x, y };
        }
        let scale = ((x.1 - x.0) / wide).max((y.1 - y.0) / high);
        Self { x: around(x, scale * wide), y: around(y, scale * high) }
    }

    fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let across = LEFT + (x - self.x.0) / (self.x.1 - self.x.0) * (WIDTH - LEFT - EDGE);
        let down = HEIGHT - FOOT - (y - self.y.0) / (self.y.1 - self.y.0) * (HEIGHT - FOOT - EDGE);
        (across, down)
    }

    fn axes(&self, out: &mut String, axes: &(String, String)) {
        let (right, base, under, beside) = (WIDTH - EDGE, HEIGHT - FOOT, HEIGHT - FOOT + 16.0, LEFT - 6.0);
        let corner = format!("{LEFT},{EDGE} {LEFT},{base} {right},{base}");
        put!(out, "<polyline class=\"axis\" points=\"{corner}\"/>\n");
        for (place, anchor, text) in [
            ((LEFT, under), "start", figure(self.x.0)),
            ((right, under), "end", figure(self.x.1)),
            ((f64::midpoint(LEFT, right), under + 14.0), "middle", axes.0.clone()),
            ((beside, base), "end", figure(self.y.0)),
            ((beside, EDGE + 8.0), "end", figure(self.y.1)),
            ((LEFT, EDGE - 8.0), "start", axes.1.clone()),
        ] {
            label(out, place, anchor, &text);
        }
    }
}

fn label(out: &mut String, (across, down): (f64, f64), anchor: &str, text: &str) {
    let text = escape(text);
    put!(out, "<text x=\"{across:.1}\" y=\"{down:.1}\" text-anchor=\"{anchor}\">{text}</text>\n");
}

fn circle(out: &mut String, (across, down): (f64, f64), class: &str, radius: f64) {
    put!(out, "<circle cx=\"{across:.1}\" cy=\"{down:.1}\" r=\"{radius}\" class=\"{class}\"/>\n");
}

pub(super) fn plot(out: &mut String, plot: &Plot) {
    let points: Vec<(f64, f64)> = finite(&plot.points).collect();
    let here: Vec<(f64, f64)> = finite(plot.here.as_slice()).collect();
    let all: Vec<(f64, f64)> = points.iter().chain(&here).copied().collect();
    // A single place in an empty frame says nothing new.
    if all.iter().all(|point| all.first() == Some(point)) {
        return;
    }
    let frame = Frame::of(&all, &plot.axes);
    put!(out, "<p class=\"title\">{}</p>\n", escape(&plot.title));
    put!(out, "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\">\n");
    frame.axes(out, &plot.axes);
    let places: Vec<(f64, f64)> = points.iter().map(|point| frame.place(*point)).collect();
    if plot.path {
        let path: Vec<String> = places.iter().map(|(across, down)| format!("{across:.1},{down:.1}")).collect();
        put!(out, "<polyline fill=\"none\" class=\"line\" points=\"{}\"/>\n", path.join(" "));
    } else {
        places.iter().for_each(|place| circle(out, *place, "dot", 1.2));
    }
    here.iter().for_each(|point| circle(out, frame.place(*point), "here", 4.0));
    if let (true, [first, .., last]) = (plot.path && is_map(&plot.axes), places.as_slice()) {
        for (place, text) in [(first, "start"), (last, "end")] {
            circle(out, *place, "dot", 3.0);
            label(out, (place.0, place.1 - 7.0), "middle", text);
        }
    }
    out.push_str("</svg>\n");
}

/// Pieces of the timeline.
const PIECES: u64 = 90;
const PIECE: u64 = 5;
const LABEL: u64 = 230;
/// On either side of the timeline.
const SIDE: u64 = 8;
const ROW: u64 = 24;

/// How many records each topic has over the time, one row for each, and when its owner noted something.
pub(super) fn timeline(out: &mut String, topics: &[(String, Vec<Timestamp>)], notes: &[Timestamp]) {
    let all = || topics.iter().flat_map(|(_, times)| times);
    let Some((first, last)) = all().copied().min().zip(all().copied().max()) else { return };
    let length = (last.0 - first.0).saturating_add(1);
    let piece_of = |at: Timestamp| u128::from(at.0 - first.0) * u128::from(PIECES) / u128::from(length);
    let (width, height) = (LABEL + PIECES * PIECE + SIDE, ROW * topics.len() as u64 + ROW);
    let noted: Vec<Timestamp> = notes.iter().copied().filter(|at| (first..=last).contains(at)).collect();
    let legend = if noted.is_empty() { "" } else { "; a line marks a note" };
    put!(
        out,
        "<p class=\"title\">Timeline: disclosed records by time of capture, as their owner claims it{legend}</p>\n"
    );
    put!(out, "<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\">\n");
    for (row, (name, times)) in (0..).zip(topics) {
        let mut counts = vec![0_u64; usize::try_from(PIECES).unwrap_or_default()];
        for time in times {
            if let Some(count) = usize::try_from(piece_of(*time)).ok().and_then(|place| counts.get_mut(place)) {
                *count += 1;
            }
        }
        let (most, base) = (counts.iter().copied().max().unwrap_or(1).max(1), ROW * (row + 1));
        put!(out, "<text x=\"{SIDE}\" y=\"{}\">{}</text>\n", base - 5, escape(name));
        for (piece, count) in (0_u64..).zip(counts).filter(|(_, count)| *count > 0) {
            let (x, tall) = (LABEL + piece * PIECE, (count * (ROW - 4) / most).max(2));
            let y = base - tall;
            put!(out, "<rect class=\"bar\" x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{tall}\"/>\n", PIECE - 1);
        }
    }
    for at in noted {
        let x = u128::from(LABEL) + piece_of(at) * u128::from(PIECE) + 2;
        put!(out, "<line class=\"note\" x1=\"{x}\" x2=\"{x}\" y1=\"0\" y2=\"{}\"/>\n", height - ROW);
    }
    let (base, end) = (height - 7, width - SIDE);
    put!(out, "<text x=\"{LABEL}\" y=\"{base}\">{}</text>\n", first.in_utc());
    put!(out, "<text x=\"{end}\" y=\"{base}\" text-anchor=\"end\">{}</text>\n</svg>\n", last.clock());
}

/// A field over time.
pub(super) fn series(name: &str, numbers: &[(Timestamp, f64)]) -> Option<Plot> {
    let (begin, _) = numbers.first()?;
    let seconds = |at: &Timestamp| Duration::from_nanos(at.0.saturating_sub(begin.0)).as_secs_f64();
    let points = numbers.iter().map(|(at, number)| (seconds(at), *number)).collect();
    let axes = ("seconds".to_owned(), name.to_owned());
    Some(Plot { title: name.to_owned(), axes, points, path: true, here: None })
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod figures_tests {
    use super::*;

    #[test]
    fn base64_is_that_of_rfc_4648() {
        for (bytes, text) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(data_uri(bytes.as_bytes()), format!("data:image/png;base64,{text}"));
        }
    }

    #[test]
    fn a_plot_has_every_point_within_its_frame_and_its_names_are_escaped() {
        let shown = Plot {
            title: "<script>alert(1)</script>".into(),
            axes: ("x\"".into(), "<y>".into()),
            points: vec![(0.0, 0.0), (f64::NAN, 1.0), (1e300, 0.0), (2.0, 4.0)],
            path: true,
            here: Some((2.0, 4.0)),
        };
        let mut out = String::new();
        plot(&mut out, &shown);
        assert!(
            out.contains("points=\"80.0,296.0 616.0,24.0\"") && out.contains("cx=\"616.0\" cy=\"24.0\" r=\"4\""),
            "{out}"
        );
        assert!(!out.contains("<script") && !out.contains("NaN") && out.contains("&lt;y&gt;"), "{out}");
        let mut nothing = String::new();
        plot(&mut nothing, &Plot { points: vec![(f64::NAN, 0.0)], ..Plot::default() });
        plot(&mut nothing, &Plot { points: vec![(1.0, 2.0)], here: Some((1.0, 2.0)), ..Plot::default() });
        assert_eq!(nothing, "", "one place is no plot");
    }

    #[test]
    fn a_timeline_has_a_bar_for_each_piece_of_time_with_records_and_hostile_names_stay_text() {
        let at = |second: u64| Timestamp::from_seconds(1_700_000_000 + second);
        let rows = [("</svg><script>".to_owned(), vec![at(0), at(1), at(180)]), ("/odom".to_owned(), vec![at(90)])];
        let mut out = String::new();
        timeline(&mut out, &rows, &[at(0), at(90), at(181)]);
        // Two of the first topic's records share a piece of two seconds.
        assert_eq!(out.matches("<rect").count(), 3, "{out}");
        assert!(!out.contains("<script") && out.contains("&lt;/svg&gt;&lt;script&gt;"), "{out}");
        assert!(out.contains("2023-11-14 22:13:20 UTC") && out.contains(">22:16:20<"), "{out}");
        assert_eq!(out.matches("<line").count(), 2, "the last note is behind the last record: {out}");
        // The last record is in the last piece, which is as long as the others.
        assert!(out.contains("x=\"675\"") && out.contains("<line class=\"note\" x1=\"452\""), "{out}");
        let mut none = String::new();
        timeline(&mut none, &[], &[]);
        assert_eq!(none, "");
    }

    #[test]
    fn a_map_has_one_scale_and_names_its_ends() {
        let axes = ("x, m".to_owned(), "y, m".to_owned());
        let shown = Plot { axes, points: vec![(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], path: true, ..Plot::default() };
        let mut out = String::new();
        plot(&mut out, &shown);
        // 272 for a metre, in the middle of 536.
        assert!(out.contains("points=\"212.0,296.0 484.0,296.0 484.0,24.0\""), "{out}");
        assert!(out.contains(">start<") && out.contains(">end<") && out.contains(">-0.485<"), "{out}");
        let mut other = String::new();
        plot(&mut other, &Plot { axes: ("seconds".into(), "battery".into()), ..shown });
        assert!(
            !other.contains(">start<") && other.contains("points=\"80.0,296.0 616.0,296.0 616.0,24.0\""),
            "{other}"
        );
        assert_eq!([0.0, -3.6354, 100.0, 0.05].map(figure), ["0", "-3.635", "100", "0.05"]);
    }

    #[test]
    fn a_series_begins_at_zero_seconds() {
        let at = |second: u64| Timestamp::from_seconds(1_700_000_000 + second);
        let plot = series("battery", &[(at(5), 0.5), (at(7), 0.25)]).expect("a plot");
        assert_eq!((plot.points, plot.axes.1.as_str()), (vec![(0.0, 0.5), (2.0, 0.25)], "battery"));
        assert_eq!(series("battery", &[]), None);
    }
}
