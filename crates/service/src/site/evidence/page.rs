//! `report.html` of a bundle. It proves nothing and says so; no scripts, no requests, every text cleaned and escaped.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;

use authros_evidence::{Bundle, RecordReport, Report};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use crate::model::{Head, Timestamp, clean};
use crate::pipeline::importer;
use crate::reply::IncidentView;
use crate::ros::message::{Folders, type_hash};
use crate::ros::readable::{self, Plot, Readable};
use crate::ros::recording::{Described, TYPE_HASH, TypeFacts};
use crate::ros::{Definition, Limits};

const MOST_ROWS: usize = 500;
const MOST_SHOWN: usize = 100;
/// Size from which disclosed records are left out, bytes.
const LONGEST: usize = 4 << 20;
const MOST_FIELDS: usize = 200;
const WIDEST: usize = 1000;

const HEAD: &str = "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
    <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:\">\n\
    <title>Evidence report</title>\n<style>\n\
    body { font: 14px/1.45 serif; max-width: 60em; margin: 2em auto; padding: 0 1em; color: #111; background: #fff }\n\
    h1, h2, h3 { font-family: sans-serif; line-height: 1.2 } h2 { border-bottom: 1px solid #999 }\n\
    table { border-collapse: collapse; width: 100%; margin: .6em 0 } th, td { border: 1px solid #bbb; padding: .2em .4em; \
    text-align: left; vertical-align: top; overflow-wrap: break-word }\n\
    th, .levels td + td { white-space: nowrap } td.long { overflow-wrap: anywhere } .facts td:first-child { width: 11em }\n\
    th { background: #eee } code, td.n { font: 12px/1.4 monospace; overflow-wrap: anywhere }\n\
    pre { font: 12px/1.4 monospace; white-space: pre-wrap; border: 1px solid #bbb; padding: .5em }\n\
    .mark { border: 3px solid #a00; padding: .6em 1em } .bad { color: #a00; font-weight: bold }\n\
    img { image-rendering: pixelated; width: 480px; max-width: 100%; border: 1px solid #bbb } svg { border: 1px solid #bbb }\n\
    @media print { body { margin: 0; max-width: none; font-size: 11px } tr, svg, img { break-inside: avoid } \
    h2, h3, p.title { break-after: avoid } svg, img { width: 340px; height: auto } .levels { font-size: 9px } }\n\
    </style>\n</head>\n<body>\n";

const MARK: &str = "<p class=\"mark\"><b>This page is not authoritative.</b> It was written by the program of the \
    person who made the file, using that program's own trust settings, and proves nothing. To see what the file \
    proves, check it: <code>authros evidence verify FILE.authros --trust trust.toml</code>, offline, with a trust file of your \
    own, or by <code>tools/verify.py</code> of the same source.</p>\n";

pub(super) fn escape(text: &str) -> String {
    let text = clean(text, WIDEST).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    text.replace('"', "&quot;").replace('\'', "&#39;")
}

fn put(out: &mut String, text: std::fmt::Arguments<'_>) {
    let _infallible = out.write_fmt(text);
}

/// Characters from which a word may break anywhere.
const LONG_WORD: usize = 40;

fn row<'a>(out: &mut String, cell: &str, cells: impl IntoIterator<Item = &'a str>) {
    out.push_str("<tr>");
    for text in cells {
        let class = if text.split_whitespace().any(|word| word.len() > LONG_WORD) { " class=\"long\"" } else { "" };
        put(out, format_args!("<{cell}{class}>{}</{cell}>", escape(text)));
    }
    out.push_str("</tr>\n");
}

fn table(out: &mut String, class: &str, head: &[&str], rows: &[Vec<String>]) {
    put(out, format_args!("<table class=\"{class}\">\n"));
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

pub(super) fn page(bundle: &Bundle, report: &Report, about: Option<&IncidentView>) -> String {
    let mut out = format!("{HEAD}<h1>Evidence report</h1>\n{MARK}");
    summary(&mut out, bundle, report);
    if let Some(about) = about {
        incident(&mut out, about);
    }
    levels(&mut out, report);
    completeness(&mut out, report);
    disclosed(&mut out, bundle, report);
    notes(&mut out, report);
    out.push_str("</body>\n</html>\n");
    out
}

fn summary(out: &mut String, bundle: &Bundle, report: &Report) {
    let (chain, exporter) = (&bundle.manifest.chain, &bundle.manifest.exporter);
    let span = |time: fn(&RecordReport) -> Option<Timestamp>| {
        let times = || report.records.iter().filter_map(time);
        match times().min().zip(times().max()) {
            Some((first, last)) => format!("{first} to {last}"),
            None => "not shown".to_owned(),
        }
    };
    let opened = report.records.iter().filter(|record| record.disclosed.is_some()).count();
    let mut owners: BTreeMap<String, u64> = BTreeMap::new();
    for record in &report.records {
        let owner = record.owner.map_or_else(|| "unreadable".to_owned(), |owner| owner.to_string());
        *owners.entry(owner).or_default() += 1;
    }
    out.push_str("<h2>What, who, when</h2>\n");
    let mut rows = vec![
        fact("Records", format!("{}, {opened} of them disclosed", report.records.len())),
        fact("Capture time (claimed by the owner)", span(|record| record.captured_at)),
        fact("Anchored (block timestamp)", span(|record| record.anchored_at)),
        fact("Existed before (trusted timestamp)", span(|record| record.existed_before)),
        fact("Assembled by", format!("{} with the key {}", exporter.account, exporter.key)),
        fact("Chain", format!("id {}, genesis {}, contract {}", chain.id, chain.genesis, chain.contract)),
    ];
    rows.extend(owners.iter().map(|(owner, records)| fact("Owner", format!("{owner}: {records} records"))));
    facts(out, &rows);
    put(out, format_args!("<p><b>Using the exporter's own trust settings: {}.</b></p>\n", escape(report.last_line())));
}

/// Topics appear as their pseudonyms.
fn incident(out: &mut String, about: &IncidentView) {
    out.push_str("<h2>Incident, in its owner's words</h2>\n");
    let until = about.until.map_or_else(|| "still open".to_owned(), |until| until.to_string());
    let mut rows = vec![fact("Name", about.name.to_string()), fact("From", about.since.to_string()), fact("To", until)];
    rows.extend(about.notes.iter().map(|note| fact(format!("Note of {}", note.at), &*note.text)));
    facts(out, &rows);
}

fn levels(out: &mut String, report: &Report) {
    out.push_str(
        "<h2>Levels</h2>\n<p>(a) the bytes are intact and signed; (b) the key was its owner's at the anchoring block; (c) \
         anchored in a block; (d) an outside authority's time; (e) opened by its owner's disclosure.</p>\n",
    );
    let mut sorted: Vec<&RecordReport> = report.records.iter().collect();
    sorted.sort_by_key(|record| (record.captured_at, record.seq, record.digest));
    let rows: Vec<Vec<String>> = sorted.into_iter().take(MOST_ROWS).map(level_row).collect();
    table(out, "levels", &["record", "number", "captured", "block", "(a)", "(b)", "(c)", "(d)", "(e)"], &rows);
    if let Some(more) = report.records.len().checked_sub(MOST_ROWS).filter(|more| *more > 0) {
        put(out, format_args!("<p>and {more} more records</p>\n"));
    }
}

fn level_row(record: &RecordReport) -> Vec<String> {
    let text = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
    let mut cells = vec![
        record.digest.to_string(),
        text(record.seq.map(|seq| seq.to_string())),
        text(record.captured_at.map(|at| at.to_string())),
        text(record.block.map(|block| block.to_string())),
    ];
    cells.extend(record.levels().map(|(_, level)| level.standing.word().to_owned()));
    cells
}

fn completeness(out: &mut String, report: &Report) {
    out.push_str("<h2>(f) Completeness of numbers</h2>\n");
    let stretches = report.complete.iter().take(MOST_ROWS);
    let rows: Vec<Vec<String>> = stretches
        .map(|one| {
            vec![one.topic_id.to_string(), one.recorder.to_string(), one.standing.word().to_owned(), one.text.clone()]
        })
        .collect();
    table(out, "plain", &["topic", "recorder", "result", "what is present"], &rows);
}

fn disclosed(out: &mut String, bundle: &Bundle, report: &Report) {
    let mut limits = Limits::default();
    // Recorders' statements are reported under (f).
    let is_chosen = |record: &&RecordReport| record.disclosed.is_some() && !record.is_statement();
    let opened: Vec<&RecordReport> = report.records.iter().filter(is_chosen).collect();
    out.push_str("<h2>Disclosed records</h2>\n");
    if opened.is_empty() {
        out.push_str("<p>None: every message in the file is sealed, except recorders' own statements.</p>\n");
    }
    for (at, record) in opened.iter().enumerate() {
        if at == MOST_SHOWN || out.len() > LONGEST {
            put(out, format_args!("<p>and {} more, which are not shown here</p>\n", opened.len() - at));
            return;
        }
        one(out, bundle, report, record, &mut limits);
    }
}

fn one(out: &mut String, bundle: &Bundle, report: &Report, record: &RecordReport, limits: &mut Limits) {
    let Some(opened) = &record.disclosed else { return };
    put(
        out,
        format_args!("<section>\n<h3>{} <code>{}</code></h3>\n", escape(&opened.topic), escape(&opened.type_name)),
    );
    let mut rows = vec![
        fact("Record", record.digest.to_string()),
        fact("Published by", opened.publisher.clone()),
        fact("Message", format!("{} bytes, SM3 {}", opened.length, opened.message_sm3)),
    ];
    rows.extend(opened.tags.iter().map(|(name, value)| fact(format!("Tag {name}"), &**value)));
    for (letter, level) in record.levels() {
        rows.push(fact(format!("({letter}) {}", level.standing.word()), &*level.text));
    }
    facts(out, &rows);
    message(out, bundle, report, record, limits);
    out.push_str("</section>\n");
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
        put(out, format_args!("<p class=\"title\">{}</p>\n", escape(&shown.title)));
        let head: Vec<&str> = shown.head.iter().map(String::as_str).collect();
        table(out, "plain", &head, &shown.rows);
    }
    if let Some(shown) = &readable.plot {
        plot(out, shown);
    }
    if let Some(png) = readable.picture.as_ref().and_then(|raster| raster.png().ok()) {
        put(out, format_args!("<p><img alt=\"the picture, reduced\" src=\"{}\"></p>\n", data_uri(&png)));
    }
}

fn notes(out: &mut String, report: &Report) {
    out.push_str("<h2>Notes</h2>\n<ul>\n");
    put(out, format_args!("<li>{}</li>\n", escape(&report.exporter.text)));
    report.warnings.iter().for_each(|text| put(out, format_args!("<li>{}</li>\n", escape(text))));
    let by_hand: String = authros_evidence::READ_ME_TEXT.lines().map(|line| escape(line) + "\n").collect();
    put(out, format_args!("</ul>\n<h2>Check it manually</h2>\n<pre>{by_hand}</pre>\n"));
}

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 320.0;
const EDGE: f64 = 24.0;

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

pub(super) fn plot(out: &mut String, plot: &Plot) {
    let points: Vec<(f64, f64)> = finite(&plot.points).collect();
    let here: Vec<(f64, f64)> = finite(plot.here.as_slice()).collect();
    let all = || points.iter().chain(&here);
    // A single place in an empty frame says nothing new.
    if all().all(|point| all().next() == Some(point)) {
        return;
    }
    let (x, y) = (ends(all().map(|point| point.0)), ends(all().map(|point| point.1)));
    let place = |point: &(f64, f64)| {
        let across = EDGE + (point.0 - x.0) / (x.1 - x.0) * (WIDTH - 2.0 * EDGE);
        let down = HEIGHT - EDGE - (point.1 - y.0) / (y.1 - y.0) * (HEIGHT - 2.0 * EDGE);
        format!("{across:.1},{down:.1}")
    };
    let path: Vec<String> = points.iter().map(place).collect();
    put(out, format_args!("<p class=\"title\">{}</p>\n", escape(&plot.title)));
    put(out, format_args!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\">\n"));
    if plot.path {
        put(out, format_args!("<polyline fill=\"none\" stroke=\"#036\" points=\"{}\"/>\n", path.join(" ")));
    }
    let dots = path.iter().filter(|_| !plot.path).map(|at| (at.clone(), "#036", 1.2));
    for (at, colour, radius) in dots.chain(here.iter().map(|point| (place(point), "#a00", 4.0))) {
        let (across, down) = at.split_once(',').unwrap_or(("0", "0"));
        put(out, format_args!("<circle cx=\"{across}\" cy=\"{down}\" r=\"{radius}\" fill=\"{colour}\"/>\n"));
    }
    let (across, up) = (escape(&plot.axes.0), escape(&plot.axes.1));
    let ends = format!("{across}: {:.3} to {:.3}; {up}: {:.3} to {:.3}", x.0, x.1, y.0, y.1);
    put(out, format_args!("</svg>\n<p>{ends}</p>\n"));
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod figure_tests {
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
            out.contains("points=\"24.0,296.0 536.0,24.0\"") && out.contains("cx=\"536.0\" cy=\"24.0\" r=\"4\""),
            "{out}"
        );
        assert!(!out.contains("<script") && !out.contains("NaN") && out.contains("&lt;y&gt;"), "{out}");
        let mut nothing = String::new();
        plot(&mut nothing, &Plot { points: vec![(f64::NAN, 0.0)], ..Plot::default() });
        plot(&mut nothing, &Plot { points: vec![(1.0, 2.0)], here: Some((1.0, 2.0)), ..Plot::default() });
        assert_eq!(nothing, "", "one place is no plot");
    }
}
