//! The large popups: records, readers, publishers, tasks, robots, incidents.

use super::frame::{draw_list, framed, name_role};
use crate::app::incidents::IncidentList;
use crate::app::opening::{BYTES_A_LINE, Face, Opening};
use crate::app::popup::{Lookup, readers};
use crate::app::screens::{LogLine, day, end, is_active, is_given, scope};
use crate::app::update::Feed;
use crate::app::{State, Tag};
use crate::model::{Timestamp, Verdict, clean, counted};
use crate::ros::readable::{Readable, Table};
use crate::service::NoticeLevel;
use crate::service::reply::{
    AlarmView, GrantRow, IncidentNoteView, IncidentView, OpenedView, PinView, PinsView, Provenance, RecordView,
    RobotView, ShownState, SpanCoverageView, TaskState, TaskView, coverage_legend,
};
use crate::ui::canvas::{Canvas, below, columns, right_of, row, rows};
use crate::ui::lists::{Fact, empty, state_role, watch_rule};
use crate::ui::theme::Role;
use crate::ui::words::{self, count, size, wrap};
use crate::ui::{bars, gateway, plot};
use ratatui::layout::Rect;
use strum::IntoEnumIterator as _;

const WIDEST: u16 = 120;

const LABEL: u16 = 20;

pub fn draw_opened(canvas: &mut Canvas, area: Rect, opening: &Opening) {
    let width = WIDEST.min(area.width.saturating_sub(6));
    let title = format!("Record {}", opening.lookup.id);
    if let Some(view) = opening.lookup.found() {
        let inner = framed(canvas, area, &title, WIDEST, u16::MAX - 2);
        return inside(canvas, inner, opening, view);
    }
    let lines = answered(&opening.lookup, width, |_| Vec::new(), |line| vec![line]);
    let inner = framed(canvas, area, &title, WIDEST, rows(lines.len()));
    put_lines(canvas, inner, &lines, 0);
}

/// Lines of an answer, or of its absence and the reason.
fn answered<T, L>(lookup: &Lookup<T>, width: u16, lines: impl FnOnce(&T) -> Vec<L>, one: fn(Piece) -> L) -> Vec<L> {
    match &lookup.answer {
        None => vec![one(("Asking…".to_owned(), Role::Dim))],
        Some(Err(failure)) => {
            wrap(&clean(&failure.message, 500), width).into_iter().map(|line| one((line, Role::Bad))).collect()
        }
        Some(Ok(view)) => lines(view),
    }
}

pub(in crate::ui) fn inside(canvas: &mut Canvas, inner: Rect, opening: &Opening, view: &OpenedView) {
    let head = if opening.alone && opening.is_drawn() { Vec::new() } else { head(view, inner.height) };
    put_lines(canvas, inner, &head, 0);
    let taken = rows(head.len());
    faces(canvas, row(inner, taken), opening, view);
    let content = below(inner, taken + 1);
    match opening.shown() {
        Face::Picture => {
            if let Some(picture) = view.readable.as_ref().and_then(|readable| readable.picture.as_ref()) {
                plot::draw_raster(canvas, content, picture);
            }
        }
        Face::Plot => draw_plot(canvas, content, opening, view),
        Face::Readable => {
            let lines = view.readable.as_ref().map(readable).unwrap_or_default();
            put_lines(canvas, content, &lines, opening.lookup.scroll);
        }
        Face::Fields => put_lines(canvas, content, &fields(view, content.width), opening.lookup.scroll),
        Face::Bytes => put_lines(canvas, content, &bytes(view), opening.lookup.scroll),
    }
}

/// Shorter without room.
fn head(view: &OpenedView, room: u16) -> Vec<Vec<Piece>> {
    let mut lines = vec![verdict_line(view.verdict)];
    let mut facts = record_lines(&view.record);
    if room < 24 {
        facts.truncate(3);
        lines.extend(facts);
        return lines;
    }
    lines.append(&mut facts);
    if !view.caller_id.is_empty() {
        lines.push(labelled("sent by", view.caller_id.clone(), Role::Body));
    }
    let shown = view.tags.iter().filter(|(name, _)| !name.starts_with("mcap."));
    let tags: Vec<String> = shown.map(|(name, value)| format!("{name}={value}")).collect();
    if !tags.is_empty() {
        lines.push(labelled("tags", tags.join("  "), Role::Dim));
    }
    if view.compression != "none" && !view.compression.is_empty() {
        let text = format!("{} sealed, compressed ({})", size(view.stored), view.compression);
        lines.push(labelled("stored", text, Role::Dim));
    }
    lines
}

fn faces(canvas: &mut Canvas, area: Rect, opening: &Opening, view: &OpenedView) {
    let shown = opening.shown();
    let mut rest = area;
    for face in Face::of(view) {
        let role = if face == shown { Role::Badge } else { Role::Dim };
        rest = canvas.puts(rest, &[(&format!(" {} ", face.title()), role), (" ", Role::Body)]);
    }
}

fn draw_plot(canvas: &mut Canvas, area: Rect, opening: &Opening, view: &OpenedView) {
    let own = view.readable.as_ref().and_then(|readable| readable.plot.as_ref());
    match opening.path.as_ref().map(|path| &path.answer) {
        Some(None) => drop(canvas.put(row(area, 0), "Reading the records up to here…", Role::Dim)),
        Some(Some(Err(failure))) => drop(canvas.put(row(area, 0), &clean(&failure.message, 300), Role::Bad)),
        Some(Some(Ok(path))) => path.plot.iter().for_each(|found| plot::draw(canvas, area, found)),
        None => own.iter().for_each(|own| plot::draw(canvas, area, own)),
    }
}

fn readable(view: &Readable) -> Vec<Vec<Piece>> {
    let widest = view.lines.iter().map(|(label, _)| columns(label) + 2).max().unwrap_or(0).max(LABEL);
    let line = |(label, value): &(String, String)| vec![(pad(label, widest), Role::Dim), (value.clone(), Role::Body)];
    let mut lines: Vec<Vec<Piece>> = view.lines.iter().map(line).collect();
    for table in &view.tables {
        lines.push(Vec::new());
        lines.push(vec![(table.title.clone(), Role::Title)]);
        lines.extend(tabled(table));
    }
    lines
}

fn tabled(table: &Table) -> Vec<Vec<Piece>> {
    let rows = || table.rows.iter().chain((!table.head.is_empty()).then_some(&table.head));
    let count = rows().map(Vec::len).max().unwrap_or(0);
    let width = |at: usize| rows().filter_map(|row| row.get(at)).map(|cell| columns(cell)).max().unwrap_or(0);
    let widths: Vec<u16> = (0..count).map(width).collect();
    let line = |cells: &Vec<String>, role: Role| -> Vec<Piece> {
        cells.iter().zip(&widths).map(|(cell, width)| (pad(cell, width + 2), role)).collect()
    };
    let head = (!table.head.is_empty()).then(|| line(&table.head, Role::Dim));
    head.into_iter().chain(table.rows.iter().map(|row| line(row, Role::Body))).collect()
}

fn fields(view: &OpenedView, width: u16) -> Vec<Vec<Piece>> {
    let widest = view.fields.iter().map(|(path, _)| columns(path)).max().unwrap_or(0);
    let label = (widest + 2).min(width / 2);
    let line = |(path, value): &(String, String)| vec![(pad(path, label), Role::Dim), (value.clone(), Role::Body)];
    let notes = view.note.iter().flat_map(|note| wrap(note, width)).map(|line| vec![(line, Role::Warning)]);
    notes.chain(view.fields.iter().map(line)).collect()
}

/// Offset, sixteen bytes, ASCII.
fn bytes(view: &OpenedView) -> Vec<Vec<Piece>> {
    let line = |(at, chunk): (usize, &[u8])| {
        let hex: Vec<String> = chunk.iter().map(|byte| format!("{byte:02x}")).collect();
        let shown = |byte: &u8| if byte.is_ascii_graphic() || *byte == b' ' { char::from(*byte) } else { '.' };
        vec![
            (format!("{:08x}  ", at * BYTES_A_LINE), Role::Dim),
            // 74 columns in all: a window of 80 fits them.
            (format!("{:47} ", hex.join(" ")), Role::Body),
            (chunk.iter().map(shown).collect(), Role::Accent),
        ]
    };
    view.beginning.chunks(BYTES_A_LINE).enumerate().map(line).collect()
}

pub(in crate::ui) fn put_lines(canvas: &mut Canvas, area: Rect, lines: &[Vec<Piece>], scroll: usize) {
    put_lines_above(canvas, area, lines, scroll, row(area, area.height.saturating_sub(1)));
}

/// `edge` says how much more there is.
fn put_lines_above(canvas: &mut Canvas, area: Rect, lines: &[Vec<Piece>], scroll: usize, edge: Rect) {
    let height = usize::from(area.height);
    let first = scroll.min(lines.len().saturating_sub(height));
    for (place, line) in (0..area.height).zip(lines.iter().skip(first)) {
        let pieces: Vec<(&str, Role)> = line.iter().map(|(text, role)| (text.as_str(), *role)).collect();
        canvas.puts(row(area, place), &pieces);
    }
    if lines.len() > first + height && height > 0 {
        canvas.put_right(edge, &format!(" {} more lines below ", lines.len() - first - height), Role::Dim);
    }
}

const STEP: u16 = 14;
const LOOKUP_WIDEST: u16 = 110;

pub(in crate::ui) type Piece = (String, Role);

pub fn draw_provenance(canvas: &mut Canvas, area: Rect, lookup: &Lookup<Provenance>) {
    let width = LOOKUP_WIDEST.min(area.width.saturating_sub(6));
    let lines = answered(lookup, width, |view| provenance_lines(view, width), |line| vec![line]);
    let inner = framed(canvas, area, &format!("Provenance of record {}", lookup.id), width, rows(lines.len()));
    let edge = Rect { y: inner.bottom().min(area.bottom().saturating_sub(1)), height: 1, ..inner };
    put_lines_above(canvas, inner, &lines, lookup.scroll, edge);
}

pub(in crate::ui) fn provenance_lines(view: &Provenance, width: u16) -> Vec<Vec<Piece>> {
    // Steps repeat the other facts; everything should fit on one screen.
    let mut lines: Vec<Vec<Piece>> = record_lines(&view.record).into_iter().take(2).collect();
    lines.push(Vec::new());
    let width = width.saturating_sub(STEP);
    for (word, evidence) in &view.steps {
        let role = step_role(word);
        let pieces = wrap(&fitted(&clean(evidence, 500), width), width);
        for (index, piece) in pieces.into_iter().enumerate() {
            let label = if index == 0 { clean(word, 13) } else { String::new() };
            lines.push(vec![(pad(&label, STEP), role), (piece, Role::Body)]);
        }
    }
    lines
}

/// Shortens hashes to their ends if the evidence does not fit; `authros records show` has them in full.
fn fitted(evidence: &str, width: u16) -> String {
    const WHOLE: usize = 40;
    if columns(evidence) <= width {
        return evidence.to_owned();
    }
    let ends = |word: &str| match (word.get(..24), word.get(word.len().saturating_sub(8)..)) {
        (Some(head), Some(tail)) if word.len() > WHOLE && word.is_ascii() => format!("{head}…{tail}"),
        _ => word.to_owned(),
    };
    evidence.split(' ').map(ends).collect::<Vec<_>>().join(" ")
}

fn step_role(word: &str) -> Role {
    match ShownState::from_word(word) {
        Some(state) => state_role(state),
        None if word == "missing" => Role::Bad,
        None => Role::Accent,
    }
}

pub(in crate::ui) fn record_lines(record: &RecordView) -> Vec<Vec<Piece>> {
    let mut type_name = labelled("type", record.type_name.clone(), Role::Body);
    if record.simulated {
        type_name.extend([("  ".to_owned(), Role::Body), ("SIMULATED".to_owned(), Role::Badge)]);
    }
    let facts = format!("seq {}, epoch {}, {}", record.seq, record.epoch, size(record.bytes));
    let (topic, captured) = (record.topic.clone(), record.captured_at.to_string());
    let mut lines = vec![labelled("topic", topic, Role::Accent), type_name];
    lines.extend([labelled("record", facts, Role::Body), labelled("captured", captured, Role::Body)]);
    lines.extend(record.owner.map(|owner| labelled("owner", owner.to_string(), Role::Body)));
    lines.push(labelled("digest", record.digest.to_hex(), Role::Dim));
    lines.extend(record.erased.as_ref().map(|erased| labelled("erased", clean(erased, 600), Role::Warning)));
    lines
}

fn verdict_line(verdict: Verdict) -> Vec<Piece> {
    let (text, role) = match verdict {
        Verdict::Verified => ("verified: digest matches the chain, signature valid", Role::Good),
        Verdict::Unanchored => ("unanchored: signature valid, but the digest is not on the chain yet", Role::Warning),
        Verdict::NotChecked => ("not checked against the chain now; confirmed earlier, signature valid", Role::Warning),
        Verdict::Tampered => ("tampered: the stored bytes are not the ones anchored or signed", Role::Bad),
        Verdict::Deleted => ("deleted by retention: header, signature and proof stay", Role::Warning),
        Verdict::Missing => ("missing: the stored bytes are gone", Role::Bad),
        Verdict::NoKey => ("no key: cannot be opened with this profile's keys", Role::Warning),
    };
    vec![(text.to_owned(), role)]
}

fn labelled(label: &str, value: String, role: Role) -> Vec<Piece> {
    vec![(pad(label, 10), Role::Dim), (value, role)]
}

fn pad(text: &str, width: u16) -> String {
    let missing = usize::from(width.saturating_sub(columns(text)));
    format!("{text}{}", " ".repeat(missing))
}

fn draw_lines(canvas: &mut Canvas, area: Rect, title: &str, lines: &[Piece], scroll: usize) {
    let width = area.width.saturating_sub(6).min(100);
    let wrapped: Vec<Piece> = lines
        .iter()
        .flat_map(|(text, role)| words::wrap(&clean(text, 1_000), width).into_iter().map(|line| (line, *role)))
        .collect();
    let widest = wrapped.iter().map(|(line, _)| columns(line)).max().unwrap_or(0);
    let inner = framed(canvas, area, title, widest.max(40), rows(wrapped.len()));
    let first = scroll.min(wrapped.len().saturating_sub(usize::from(inner.height)));
    for (place, (line, role)) in (0..inner.height).zip(wrapped.iter().skip(first)) {
        canvas.put(row(inner, place), line, *role);
    }
}

/// No topic = all of them.
pub fn draw_readers(canvas: &mut Canvas, area: Rect, state: &State, topics: &[String]) {
    let mut lines: Vec<Piece> = Vec::new();
    if topics.is_empty() {
        let readers = readers(state, "New records of all topics:", None);
        lines.extend(readers.into_iter().map(|line| (line, Role::Body)));
    }
    let given: Vec<&GrantRow> = state.grants.rows.iter().filter(|row| is_given(row) && is_active(row)).collect();
    for topic in topics.iter().take(8) {
        lines.push((topic.clone(), Role::Accent));
        lines.push(("  you, while your keyring is unlocked".to_owned(), Role::Body));
        let may = given.iter().filter(|row| row.topics.is_empty() || row.topics.contains(topic));
        lines.extend(may.map(|row| (reader(row), Role::Body)));
    }
    if topics.len() > 8 {
        lines.push((format!("and {} more topics", topics.len() - 8), Role::Dim));
    }
    if !topics.is_empty() && state.awaits(Feed::Grants) {
        lines.push(("(the list of grants has not arrived yet)".to_owned(), Role::Warning));
    }
    let text = "Revoking does not undo reads: anyone who read a record may have kept it.";
    lines.extend([Piece::default(), (text.to_owned(), Role::Dim)]);
    draw_lines(canvas, area, "Who can read this now?", &lines, 0);
}

fn reader(row: &GrantRow) -> String {
    let name = row.name.as_deref().map_or_else(|| row.grantee.to_string(), |name| format!("{name} {}", row.grantee));
    format!("  {name}, {}, {}", scope(&row.topics), end(row.expires))
}

pub fn draw_publishers(canvas: &mut Canvas, area: Rect, state: &State, lookup: &Lookup<PinsView>) {
    let width = area.width.saturating_sub(6).min(100);
    let lines = answered(lookup, width, |view| publishers(state, &lookup.id, view), |line| line);
    draw_lines(canvas, area, &format!("Publishers of {}", lookup.id), &lines, lookup.scroll);
}

fn publishers(state: &State, topic: &str, view: &PinsView) -> Vec<Piece> {
    let mut lines = Vec::new();
    let row = state.topics.rows.iter().find(|row| row.topic == topic);
    let now = row.map_or_else(String::new, |row| row.publishers.join(" "));
    lines.extend(coverage_lines(state, topic));
    let rule = row.and_then(watch_rule);
    lines.extend(rule.map(|rule| (format!("watched {rule}; l on Topics changes how much is kept"), Role::Body)));
    lines.push((format!("now     {}", if now.is_empty() { "nobody" } else { &now }), Role::Body));
    if view.pins.is_empty() {
        lines.push(("no publisher is pinned yet: the first one captured will be".to_owned(), Role::Dim));
    }
    lines.extend(view.pins.iter().flat_map(|pin| pinned(pin, &now)));
    lines.extend(view.alarms.iter().flat_map(alarm));
    if let Some(held) = row.map(|row| row.quarantined).filter(|held| *held > 0) {
        lines.push((format!("{held} messages are quarantined: r releases, D discards (on the screen)"), Role::Warning));
    }
    lines
}

/// From when to when, a strip of signs, and their meaning.
pub fn coverage_lines(state: &State, topic: &str) -> Vec<Piece> {
    let Some((of, answer)) = &state.detail.coverage else { return Vec::new() };
    match answer {
        _ if of != topic => Vec::new(),
        Err(failure) => vec![(clean(&failure.message, 500), Role::Bad)],
        Ok(view) if view.first.is_none() => {
            vec![("No records of this topic yet.".to_owned(), Role::Dim), Piece::default()]
        }
        Ok(view) => vec![
            (format!("Records from {} to {} UTC", day(view.since), day(view.until)), Role::Title),
            (view.strip(), Role::Accent),
            (view.legend(), Role::Dim),
            Piece::default(),
        ],
    }
}

fn pinned(pin: &PinView, now: &str) -> [Piece; 2] {
    let publisher = &pin.publisher;
    let there =
        if now.split(' ').any(|name| name == publisher.caller_id) { "publishing now" } else { "not publishing" };
    let since = pin.at.map_or_else(String::new, |at| format!(" since {}", at.in_milliseconds()));
    [
        (format!("pinned  {} at {}, {there}", publisher.caller_id, publisher.host), Role::Good),
        (format!("        {} {}, by {}{since}", publisher.type_name, publisher.md5sum, pin.source), Role::Dim),
    ]
}

fn alarm(alarm: &AlarmView) -> [Piece; 2] {
    let (word, role) = if alarm.open { ("ALARM", Role::Bad) } else { ("decided", Role::Dim) };
    [
        (format!("{word}  {}: {}", alarm.publisher, reason(&alarm.reason)), role),
        (format!("        raised {}", alarm.at), Role::Dim),
    ]
}

fn reason(word: &str) -> &str {
    match word {
        "new" => "not among the pinned publishers",
        "host" => "a pinned name on another host",
        "type" => "a pinned name with another type",
        "replaced" => "took over the name of a running publisher",
        "undecided" => "restart or rival: cannot be determined",
        "unconfirmed" => "not confirmed by the master",
        other => other,
    }
}

pub fn draw_line(canvas: &mut Canvas, area: Rect, line: &LogLine) {
    let about = format!("{}  {}  {}", line.at.in_milliseconds(), line.level.word(), line.key);
    let role = if line.level == NoticeLevel::Info { Role::Body } else { bars::notice_level(line.level).1 };
    draw_lines(canvas, area, "Log line", &[(about, Role::Dim), (line.text.clone(), role)], 0);
}

pub fn draw_alerts(canvas: &mut Canvas, area: Rect, state: &State, scroll: usize) {
    let mut lines: Vec<Piece> = Vec::new();
    for alert in state.alerts.shown() {
        let (mark, role) = bars::notice_level(alert.level);
        let often = if alert.count > 1 { format!(", {} times", alert.count) } else { String::new() };
        let when = match alert.resolved {
            Some(at) => format!("resolved {}, began {}{often}", at.in_milliseconds(), alert.since.in_milliseconds()),
            None => format!("since {}{often}", alert.since.in_milliseconds()),
        };
        lines.push((format!("{mark}{}", alert.text), if alert.resolved.is_some() { Role::Dim } else { role }));
        lines.extend([(when, Role::Dim), Piece::default()]);
    }
    if lines.pop().is_none() {
        lines.push(("no alerts".to_owned(), Role::Dim));
    }
    draw_lines(canvas, area, "Alerts", &lines, scroll);
}

pub fn draw_tasks(canvas: &mut Canvas, area: Rect, state: &State) {
    let mut lines: Vec<Piece> = state.work.iter().map(Tag::words).map(|words| (words, Role::Accent)).collect();
    lines.extend(state.progress.lines(state.shown_at()).into_iter().map(|line| (line, Role::Accent)));
    if lines.is_empty() {
        lines.push(("no commands running".to_owned(), Role::Dim));
    }
    lines.extend(records_on_their_way(state));
    lines.extend(workers(state));
    if let Some(chain) = &state.chain {
        let pending = format!("{:<15} {} pending", "transactions", chain.pending);
        lines.push((pending, if chain.pending > 0 { Role::Warning } else { Role::Body }));
        let causes = chain.lanes.iter().filter_map(|lane| Some(lane.paused.as_ref()?.cause(lane.account)));
        lines.extend(causes.map(|cause| (format!("paused  {cause}"), Role::Bad)));
    }
    for feed in Feed::iter() {
        let slot = state.feeds.slot(feed);
        if let (Some(failure), Some(at)) = (&slot.failure, slot.retry_at) {
            let seconds = at.0.saturating_sub(state.now.0) / 1_000_000_000;
            lines.push((format!("retry in {seconds} s  {feed:?}: {}", failure.message), Role::Warning));
        }
    }
    draw_lines(canvas, area, "Tasks", &lines, 0);
}

/// How many run, and each that stopped or restarted.
fn workers(state: &State) -> Vec<Piece> {
    let tasks: &[TaskView] = state.site.as_ref().map_or(&[], |site| &site.tasks);
    let running = tasks.iter().filter(|task| task.state == TaskState::Running).count();
    let mut lines = Vec::new();
    if !tasks.is_empty() {
        lines.push((format!("{:<15} {running} of {} running", "workers", tasks.len()), Role::Body));
    }
    for task in tasks.iter().filter(|task| task.state != TaskState::Running || task.restarts > 0) {
        let next = task.next_try.map_or_else(String::new, |seconds| format!(", retry in {seconds} s"));
        let why = task.reason.as_deref().map_or_else(String::new, |reason| format!(": {reason}"));
        let text = format!("{:<15} restarted {}{next}{why}", task.name, words::times(task.restarts));
        lines.push((text, if task.state == TaskState::Running { Role::Warning } else { Role::Bad }));
    }
    lines
}

fn records_on_their_way(state: &State) -> Vec<Piece> {
    let Some(site) = &state.site else { return vec![("the site is starting…".to_owned(), Role::Dim)] };
    let life = &site.life;
    let queue = &site.queue;
    let full = queue.bytes.saturating_mul(100).checked_div(queue.capacity).unwrap_or(0);
    let (messages, bytes) = (counted(queue.messages, "message"), words::size(queue.bytes));
    let stored = format!("{:<15} {messages}, {bytes} (buffer {full} % full)", "to be stored");
    let mut lines = vec![(stored, if full >= 80 { Role::Bad } else { Role::Body })];
    let stations = [
        ("to be anchored", life.stored.saturating_sub(life.anchored)),
        ("to be confirmed", life.anchored.saturating_sub(life.confirmed)),
        ("to be verified", life.confirmed.saturating_sub(life.verified + life.tampered)),
    ];
    lines.extend(stations.into_iter().map(|(what, count)| (format!("{what:<15} {}", words::count(count)), Role::Body)));
    lines.push((left(life.pending, state.rates.captured(), state.rates.verified()), Role::Accent));
    lines
}

/// At the present rates.
fn left(pending: u64, captured: f64, verified: f64) -> String {
    if pending == 0 {
        return "all captured records are verified, quarantined or accounted for".to_owned();
    }
    let count = words::count(pending);
    if verified < 0.1 {
        return format!("{count} pending; nothing is being verified now");
    }
    let records = f64::from(u32::try_from(pending).unwrap_or(u32::MAX));
    let net = verified - captured;
    if captured > 0.1 && net <= 0.1 {
        let behind = records / verified;
        return format!("{count} pending, about {behind:.0} s behind; keeping up");
    }
    format!("{count} pending, done in about {:.0} s", records / net.max(0.1))
}

const ROBOT_LABEL: u16 = 10;
const NUMBER: usize = 9;

pub fn draw_robot(canvas: &mut Canvas, area: Rect, state: &State, lookup: &Lookup<RobotView>) {
    let width = LOOKUP_WIDEST.min(area.width.saturating_sub(6));
    let whole = |view: &RobotView| {
        [told(&gateway::facts(view, state.shown_at()), width), topics(state, view, width), robot_text(view, width)]
            .concat()
    };
    let lines = answered(lookup, width, whole, |line| line);
    let name = lookup.found().map_or(lookup.id.as_str(), |view| view.row.name.as_str());
    let widest = lines.iter().map(|(line, _)| columns(line)).max().unwrap_or(0).clamp(40, width.max(40));
    let inner = framed(canvas, area, &format!("Robot {}", clean(name, 64)), widest, rows(lines.len()));
    draw_told(canvas, inner, &lines, lookup.scroll);
}

/// Says a repeated name once.
fn told(facts: &[Fact], width: u16) -> Vec<Piece> {
    let mut lines = Vec::new();
    let mut before = "";
    for (name, text, role) in facts {
        for (place, part) in wrap(&clean(text, 2_000), width.saturating_sub(ROBOT_LABEL)).into_iter().enumerate() {
            let label = if place == 0 && *name != before { *name } else { "" };
            lines.push((format!("{}{part}", pad(label, ROBOT_LABEL)), *role));
        }
        before = name;
    }
    lines
}

/// Counts of each topic, and below them from when to when there are records, with the holes.
fn topics(state: &State, view: &RobotView, width: u16) -> Vec<Piece> {
    if view.topics.is_empty() {
        return vec![Piece::default(), ("Nothing was recorded by this robot yet.".to_owned(), Role::Dim)];
    }
    let numbers = |cells: [String; 4]| cells.iter().map(|cell| format!(" {cell:>NUMBER$}")).collect::<String>();
    let name = usize::from(width).saturating_sub(4 * (NUMBER + 1)).min(48);
    let heads = ["messages", "verified", "waiting", "lost"].map(str::to_owned);
    let mut lines = vec![Piece::default(), (format!("{:name$}{}", "topic", numbers(heads)), Role::Title)];
    for topic in &view.topics {
        let cells = [topic.records, topic.verified, topic.waiting, topic.lost].map(count);
        let role = if topic.lost > 0 { Role::Warning } else { Role::Body };
        let shown = pad(&clean(&topic.topic, name), rows(name));
        lines.push((format!("{shown}{}", numbers(cells)), role));
        if let (Some(first), Some(last)) = (topic.first, topic.last) {
            lines.push((format!("  {}  {}", topic.strip, from_to(state, first, last)), Role::Accent));
        }
    }
    lines.extend(view.covered.map(|span| {
        let signs: String = view.topics.iter().map(|topic| topic.strip.as_str()).collect();
        let meaning = format!("{} per sign since {} UTC: {}", span.part(), day(span.since), coverage_legend(&signs));
        (meaning, Role::Dim)
    }));
    lines
}

fn robot_text(view: &RobotView, width: u16) -> Vec<Piece> {
    let mut lines = vec![Piece::default()];
    if view.policy.is_empty() {
        let why = if view.row.wanted == 0 { "No policy was set" } else { "The policy was cleared" };
        lines.push((format!("{why}: only the robot's own settings apply."), Role::Dim));
        return lines;
    }
    lines.push((format!("Policy {}, as it was set:", view.row.wanted), Role::Title));
    let parts = view.policy.trim_end().lines().flat_map(|line| wrap(&clean(line, 500), width));
    lines.extend(parts.map(|line| (line, Role::Body)));
    lines
}

const INCIDENT_NAME: u16 = 22;
const STATE: u16 = 8;
const DAY: u64 = 86_400;

pub fn draw_incidents(canvas: &mut Canvas, area: Rect, state: &State, list: &IncidentList) {
    let width = LOOKUP_WIDEST.min(area.width.saturating_sub(6));
    let Some(chosen) = list.chosen(state) else {
        let inner = framed(canvas, area, "Incidents", width.min(72), 2);
        let nothing = "No incidents yet: n opens one, to keep the records of a time span.";
        canvas.put(inner, empty(state, Feed::Incidents, nothing), Role::Dim);
        return;
    };
    let incidents = &state.incidents.rows;
    let told: Vec<Piece> = holdings(state, chosen)
        .into_iter()
        .flat_map(|(text, role)| words::wrap(&text, width).into_iter().map(move |line| (line, role)))
        .collect();
    // The list takes a third, however many there are.
    let listed = rows(incidents.len()).min((area.height.saturating_sub(4) / 3).max(1));
    let inner = framed(canvas, area, "Incidents", width, rows(told.len()).saturating_add(listed + 1));
    draw_list(canvas, Rect { height: listed, ..inner }, incidents, list.selected, draw_incident);
    draw_told(canvas, below(inner, listed + 1), &told, list.scroll);
}

fn draw_incident(canvas: &mut Canvas, line: Rect, incident: &IncidentView, here: bool) {
    let name = Rect { width: INCIDENT_NAME.min(line.width), ..line };
    canvas.put(name, incident.name.as_str(), name_role(here));
    let rest = right_of(line, INCIDENT_NAME + 1);
    let (word, role) = if incident.open { ("open", Role::Good) } else { ("closed", Role::Dim) };
    canvas.put(rest, word, role);
    let topics = incident.coverage.iter().filter(|one| one.records > 0).count() as u64;
    let held = format!("{} in {}", counted(incident.records, "record"), counted(topics, "topic"));
    canvas.puts(
        right_of(rest, STATE),
        &[(&held, Role::Body), (&format!(", {}", words::size(incident.bytes)), Role::Dim)],
    );
}

/// Says how many lines are above and below.
fn draw_told(canvas: &mut Canvas, area: Rect, told: &[Piece], scroll: usize) {
    let height = usize::from(area.height);
    let first = scroll.min(told.len().saturating_sub(height));
    for (place, (line, role)) in (0..area.height).zip(told.iter().skip(first)) {
        canvas.put(row(area, place), line, *role);
    }
    let left = told.len().saturating_sub(first + height);
    if first > 0 || left > 0 {
        let edge = Rect { y: area.bottom(), height: 1, ..area };
        canvas.put_right(edge, &format!(" {first} above, {left} below "), Role::Dim);
    }
}

/// Span, notes, and coverage of each topic.
fn holdings(state: &State, incident: &IncidentView) -> Vec<Piece> {
    let to = match incident.until {
        Some(until) => format!("to {} UTC", day(until)),
        None => "UTC, until it is closed".to_owned(),
    };
    let about = match incident.topics.len() {
        0 => "all topics".to_owned(),
        count => counted(count as u64, "topic"),
    };
    let mut lines = vec![(format!("From {} {to}, {about}", day(incident.since)), Role::Title)];
    lines.extend(incident.notes.iter().flat_map(note));
    lines.push(Piece::default());
    if incident.coverage.is_empty() {
        lines.push(("Nothing was recorded in that time.".to_owned(), Role::Dim));
    }
    lines.extend(incident.coverage.iter().flat_map(|one| topic(state, one)));
    lines
}

fn note(note: &IncidentNoteView) -> Vec<Piece> {
    let mut lines = note.text.lines().map(|line| clean(line, 2_000));
    let first = lines.next().unwrap_or_default();
    let rest = lines.map(|line| (format!("  {line}"), Role::Body));
    std::iter::once((format!("{}  {first}", day(note.at)), Role::Body)).chain(rest).collect()
}

fn topic(state: &State, one: &SpanCoverageView) -> Vec<Piece> {
    let name = clean(&one.topic, 255);
    let mut lines = match (one.first, one.last) {
        (Some(first), Some(last)) => {
            vec![(format!("{name}  {}, {}", counted(one.records, "record"), from_to(state, first, last)), Role::Body)]
        }
        _ if one.quarantined > 0 => vec![(format!("{name}  no record"), Role::Warning)],
        _ => vec![(format!("{name}  nothing in that time: check the name and whether it is watched"), Role::Warning)],
    };
    let missing =
        [(one.lost, "lost"), (one.quarantined, "in quarantine"), (one.deleted, "deleted earlier by retention")];
    let missing: Vec<String> = missing
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, word)| format!("{} {word}", words::count(count)))
        .collect();
    if !missing.is_empty() {
        lines.push((format!("  {}", missing.join(", ")), Role::Warning));
    }
    lines
}

fn from_to(state: &State, first: Timestamp, last: Timestamp) -> String {
    if first.seconds() / DAY == last.seconds() / DAY {
        return format!("{} to {}", state.clock(first), state.clock(last));
    }
    format!("{} to {}", day(first), day(last))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_told_as_far_as_it_can_be() {
        assert!(left(0, 0.0, 0.0).starts_with("all"));
        assert!(left(45, 20.0, 0.0).contains("nothing is being verified"));
        assert!(left(45, 20.0, 20.0).contains("about 2 s behind"));
        assert!(left(45, 0.0, 15.0).contains("done in about 3 s"));
    }
}
