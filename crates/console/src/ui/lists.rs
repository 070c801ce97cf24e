//! The list screens: Topics, Records, Received, Grants, Keys, Chain and Log.

use super::bars::notice_level;
use super::canvas::{Canvas, below, right_of, row};
use super::graph;
use super::table::{Column, Layout, Sheet, draw as draw_table, order, with_local_time};
use super::theme::Role;
use super::words;
use crate::app::leaving::{self, Capture};
use crate::app::screens::topics::SAMPLES;
use crate::app::screens::{LogLine, Records, Source, Wanted, day, is_active, is_given, key, other_side, scope, soon};
use crate::app::update::Feed;
use crate::app::{Screen, State};
use crate::model::{Address, RecordKind, RecordState, Timestamp, clean};
use crate::pipeline::sender::LaneState;
use crate::service::NoticeLevel;
use crate::service::reply::{
    AdministrationView, Caveat, ChainView, EpochView, GasView, GrantRow, IdentityView, KeysView, RecordView,
    ShownState, TopicRow,
};
use ratatui::layout::Rect;

pub fn draw_chain(canvas: &mut Canvas, area: Rect, state: &State) {
    canvas.put(area, "Chain", Role::Title);
    let area = below(area, 1);
    match &state.chain {
        Some(chain) => draw_known(canvas, area, state, chain),
        None => drop(canvas.put_wrapped(area, empty(state, Feed::Chain, "Asking…"), Role::Dim)),
    }
}

fn draw_known(canvas: &mut Canvas, area: Rect, state: &State, chain: &ChainView) {
    let contract = chain.contract.map_or_else(|| "not deployed yet".to_owned(), |contract| contract.to_string());
    let kind =
        chain.through.as_ref().map_or_else(|| chain.kind.clone(), |through| format!("{}, {through}", chain.kind));
    let lines = [
        ("Kind", kind),
        ("Node", chain.client.clone()),
        ("Consensus", format!("{}{}", chain.consensus, sealing(chain))),
        ("Chain id", chain.chain_id.to_string()),
        ("Genesis", chain.genesis.to_string()),
        ("Block", words::count(chain.block)),
        ("Contract", contract),
        ("Address", state.address().map_or_else(|| "no identity yet".to_owned(), |address| address.to_string())),
        ("Balance", ether(&chain.balance)),
        ("Next nonce", chain.nonce.to_string()),
        ("Pending", format!("{} of your transactions not in a block yet", chain.pending)),
        ("Gas", gas(&chain.gas)),
        ("Admin", administrator(state, &chain.administration)),
    ];
    let taken = draw_facts(canvas, area, &lines.map(|(label, value)| (label, value, Role::Body))) + 1;
    let told = draw_facts(canvas, below(area, taken), &decisions(&chain.administration));
    let lanes = told + draw_lanes(canvas, below(area, taken + told), &chain.lanes);
    if let Some(failure) = &state.feeds.slot(Feed::Chain).failure {
        canvas.put_wrapped(below(area, taken + 1 + lanes), &failure.message, Role::Bad);
    }
}

fn decisions(decided: &AdministrationView) -> Vec<Fact> {
    let shown = |account: Address, name: &Option<String>| name.clone().unwrap_or_else(|| account.to_string());
    let paused = decided.paused.then(|| {
        let end = decided.paused_until.map_or_else(String::new, |until| format!(", until {until}"));
        ("Paused", format!("by the administrator: no changes except revokes{end}"), Role::Warning)
    });
    let proposals = decided.proposals.iter().map(|one| {
        let (lost, successor) = (shown(one.lost, &one.lost_name), shown(one.successor, &one.successor_name));
        ("Proposed", format!("{successor} for {lost}, from {} on", one.due), Role::Warning)
    });
    let successions = decided.successions.iter().map(|one| {
        let (lost, successor) = (shown(one.lost, &one.lost_name), shown(one.successor, &one.successor_name));
        ("Successor", format!("{successor} for {lost}, lost"), Role::Warning)
    });
    paused.into_iter().chain(proposals).chain(successions).collect()
}

/// Returns the rows taken.
fn draw_lanes(canvas: &mut Canvas, area: Rect, lanes: &[LaneState]) -> u16 {
    let mut place = 0;
    for (number, lane) in (1..).zip(lanes) {
        let what = format!("{}  {} pending", lane.account, lane.open);
        draw_fact(canvas, row(area, place), &format!("Lane {number}"), &what, Role::Body);
        place += 1;
        if let Some(paused) = &lane.paused {
            canvas.put(row(area, place), &format!("  paused: {}", paused.cause(lane.account)), Role::Bad);
            place += 1;
        }
    }
    place
}

/// Per record, over the newest transactions.
fn gas(view: &GasView) -> String {
    if view.records == 0 {
        return "nothing anchored yet".to_owned();
    }
    let each = view.gas / view.records;
    let (transactions, records) = (words::count(view.transactions), words::count(view.records));
    format!("{} per record ({records} records in the last {transactions} transactions)", words::count(each))
}

fn administrator(state: &State, decided: &AdministrationView) -> String {
    let Some(administrator) = decided.administrator else { return "not known yet".to_owned() };
    let whose = if Some(administrator) == state.address() { "you; press : for your commands" } else { "not you" };
    let registration = if decided.open { "anyone can register" } else { "only allowed accounts can register" };
    format!("{} ({whose}), {registration}", administrator.short())
}

fn sealing(chain: &ChainView) -> String {
    let sealing = &chain.sealing;
    let mut parts = Vec::new();
    parts.extend(sealing.period.map(|period| format!("at least {period} ms between blocks")));
    parts.extend(sealing.difficulty.as_ref().map(|difficulty| format!("difficulty {difficulty}")));
    if chain.consensus == "poa" && !sealing.sealers.is_empty() {
        let signers = if sealing.sealers.len() == 1 { "signer" } else { "signers" };
        parts.push(format!("{} {signers}", sealing.sealers.len()));
    }
    if parts.is_empty() { String::new() } else { format!(", {}", parts.join(", ")) }
}

/// Wei as ether, if it is a round number of at least a millionth.
fn ether(wei: &str) -> String {
    const DIGITS: usize = 18;
    if wei.len() + 6 <= DIGITS || !wei.bytes().all(|digit| digit.is_ascii_digit()) {
        return format!("{wei} wei");
    }
    let padded = format!("{wei:0>width$}", width = DIGITS + 1);
    let (whole, part) = padded.split_at(padded.len() - DIGITS);
    format!("{whole}.{} ether", &part[..6])
}

const GRANT_COLUMNS: &[Column] = &[
    Column::text("State", 8),
    Column::text("", 8),
    Column::text("Account", 13),
    Column::text("Full address", 42).from(130),
    Column::text("SM2 fingerprint", 39).from(180),
    Column::name("Topics"),
    Column::text("Opens since UTC", 16).from(100),
    Column::number("Records", 9),
    Column::text("Ends UTC", 18).from(75),
    Column::number("Block", 8).from(100),
];

pub fn draw_grants(canvas: &mut Canvas, area: Rect, state: &State) {
    let (grants, table) = (&state.grants, &state.grants.table);
    let rows = grants.visible();
    let keys: Vec<String> = rows.iter().map(|row| key(row)).collect();
    let readers = grants.rows.iter().filter(|row| is_given(row) && is_active(row)).count();
    let order = order(Screen::Grants, table);
    let note = format!("{} of {}, by {order}; {readers} can read new records now", rows.len(), grants.rows.len());
    let cells = |index: usize| rows.get(index).map_or_else(Vec::new, |row| grant_cells(state, row));
    let empty = empty(state, Feed::Grants, "No grants given or received yet; press g to grant.");
    let (title, columns) = ("Grants", GRANT_COLUMNS);
    let sheet = Sheet { title, note, columns, keys: &keys, cells: &cells, table, empty, old: false };
    draw_table(canvas, area, &sheet);
}

/// An end soon shows the time left beside the clock.
fn ends(state: &State, row: &GrantRow) -> (String, Role) {
    let Some(end) = row.expires else { return ("no end".to_owned(), Role::Dim) };
    match soon(row.expires, state.shown_at()).filter(|_| is_active(row)) {
        Some(left) => (format!("{left}, {}", end.clock().get(..5).unwrap_or_default()), Role::Warning),
        None => (day(end), Role::Dim),
    }
}

fn grant_cells(state: &State, row: &GrantRow) -> Vec<(String, Role)> {
    let role = if is_active(row) { Role::Good } else { Role::Dim };
    let direction = if is_given(row) { "given to" } else { "got from" };
    vec![
        (row.state.word().to_owned(), role),
        (direction.to_owned(), Role::Body),
        (row.name.clone().unwrap_or_else(|| other_side(row).short()), Role::Accent),
        (other_side(row).to_string(), Role::Dim),
        (row.fingerprint.clone().unwrap_or_else(|| "not registered".to_owned()), Role::Dim),
        (scope(&row.topics), Role::Body),
        (row.opens.and_then(|opens| opens.since).map_or_else(|| "-".to_owned(), day), Role::Dim),
        (row.opens.map_or_else(|| "-".to_owned(), |opens| words::count(opens.records)), Role::Body),
        ends(state, row),
        (row.block.to_string(), Role::Dim),
    ]
}

const LABEL: u16 = 12;

fn draw_fact(canvas: &mut Canvas, area: Rect, label: &str, value: &str, role: Role) {
    canvas.put(Rect { width: LABEL.min(area.width), ..area }, label, Role::Dim);
    canvas.put(right_of(area, LABEL), value, role);
}

/// Label, words, role.
pub type Fact = (&'static str, String, Role);

/// Returns the rows taken.
pub fn draw_facts(canvas: &mut Canvas, area: Rect, facts: &[Fact]) -> u16 {
    for (place, (label, value, role)) in (0u16..).zip(facts) {
        draw_fact(canvas, row(area, place), label, value, *role);
    }
    super::canvas::rows(facts.len())
}

pub fn draw_keys(canvas: &mut Canvas, area: Rect, state: &State) {
    canvas.put(area, "Keys", Role::Title);
    let area = below(area, 1);
    match &state.identity {
        None => drop(canvas.put(area, "The site is starting…", Role::Dim)),
        Some(identity) if !identity.exists => {
            let text = "This profile has no identity yet: n creates one.";
            canvas.put(area, text, Role::Body);
        }
        Some(identity) => draw_identity(canvas, area, state, identity),
    }
}

fn draw_identity(canvas: &mut Canvas, area: Rect, state: &State, identity: &IdentityView) {
    let address = identity.address.map(|address| address.to_string()).unwrap_or_default();
    let locked = match leaving::captured(state) {
        Some(_) => "locked (u unlocks it); capture and anchoring continue",
        None => "locked (u unlocks it)",
    };
    let (keyring, keyring_role) = if identity.unlocked { ("unlocked", Role::Good) } else { (locked, Role::Warning) };
    let (chain, chain_role) =
        if identity.registered { ("registered", Role::Good) } else { ("not registered: R registers", Role::Warning) };
    let facts = [
        ("Profile", identity.profile.to_string(), Role::Body),
        ("Keyring", keyring.to_owned(), keyring_role),
        ("On chain", chain.to_owned(), chain_role),
        ("Address", address, Role::Accent),
    ];
    let taken = draw_facts(canvas, area, &facts);
    let hint = "y copies it for anyone who wants to share with you; b backs up";
    canvas.put(right_of(row(area, taken), LABEL), hint, Role::Dim);
    let rest = below(area, taken + 2);
    let failure = state.feeds.slot(Feed::Keys).failure.as_ref();
    let missing = match &state.keys {
        Some(keys) => return draw_epochs(canvas, rest, keys),
        None if !identity.unlocked => "Fingerprints and epochs come from the keyring: u unlocks it.",
        None => failure.map_or("Asking for the keys…", |failure| &failure.message),
    };
    canvas.put(rest, missing, Role::Dim);
}

fn draw_epochs(canvas: &mut Canvas, area: Rect, keys: &KeysView) {
    draw_fact(canvas, row(area, 0), "SM2 signing", &keys.signing_fingerprint, Role::Body);
    draw_fact(canvas, row(area, 1), "SM2 decrypt", &keys.envelope_fingerprint, Role::Body);
    let area = below(area, 3);
    let about = "  newest first; token = public commitment to each key";
    canvas.puts(area, &[("SM4 epochs", Role::Title), (about, Role::Dim)]);
    let mut epochs: Vec<&EpochView> = keys.epochs.iter().collect();
    epochs.sort_by_key(|epoch| std::cmp::Reverse(epoch.epoch));
    for (place, epoch) in (1u16..area.height).zip(epochs) {
        let now = if epoch.current { "in use" } else { "" };
        let number = format!("{:>6}  ", epoch.epoch);
        let token = format!("{}…  ", epoch.token.to_hex().chars().take(16).collect::<String>());
        canvas.puts(row(area, place), &[(&number, Role::Body), (&token, Role::Dim), (now, Role::Good)]);
    }
}

const LOG_COLUMNS: &[Column] =
    &[Column::text("UTC", 8), Column::text("Level", 7), Column::text("From", 11), Column::wide("What")];

pub fn draw_log(canvas: &mut Canvas, area: Rect, state: &State) {
    let log = &state.log;
    let lines = log.visible();
    let keys: Vec<String> = lines.iter().map(|line| line.key.clone()).collect();
    let least = match log.least {
        NoticeLevel::Info => "all levels",
        NoticeLevel::Warning => "warnings and errors",
        NoticeLevel::Error => "errors",
    };
    let from = log.source.map_or_else(|| "all sources".to_owned(), |source| format!("from {}", source.word()));
    let follows = if log.table.is_bound() { "held (home: newest)" } else { "newest first" };
    let note = format!("{} of {} lines, {least}, {from}, {follows}", lines.len(), log.count());
    let cells = |index: usize| lines.get(index).map_or_else(Vec::new, |line| log_cells(state, line));
    let (title, empty, columns) = ("Log", "Nothing yet.", &with_local_time(LOG_COLUMNS, state));
    let sheet = Sheet { title, note, columns, keys: &keys, cells: &cells, table: &log.table, empty, old: false };
    draw_table(canvas, area, &sheet);
}

fn log_cells(state: &State, line: &LogLine) -> Vec<(String, Role)> {
    let role = if line.level == NoticeLevel::Info { Role::Dim } else { notice_level(line.level).1 };
    // Audit lines show their number.
    let from = if line.source == Source::Audit { line.key.as_str() } else { line.source.word() };
    vec![
        (state.clock(line.at), Role::Dim),
        (line.level.word().to_owned(), role),
        (from.to_owned(), Role::Dim),
        (line.text.clone(), Role::Body),
    ]
}

const TOPIC_COLUMNS: &[Column] = &[
    Column::name("Topic").named("topic"),
    Column::text("Type", 27).named("type"),
    Column::text("Publishers", 24).named("publishers"),
    Column::text("Pinned", 10).named("pinned"),
    Column::text("Watched", 13).named("watched"),
    Column::text("Kept", 24).named("kept"),
    Column::number("Hz", 7).named("hz"),
    Column::number("kB/s", 8).named("rate"),
    Column::text("Last 16 s", 9).named("line"),
    Column::number("Captured", 9).named("captured"),
    Column::number("Lost", 8).named("lost"),
    Column::number("Age", 6).named("age"),
    Column::text("", 3).below(100),
    Column::text("", 9).from(100),
];

/// Cells of a topic's line, two seconds each.
const CELLS: u16 = 8;

/// Terminal width that fits all topic columns.
const ALL_FROM: u16 = 170;

/// Says which losses the two numbers are where there is room for it.
fn topic_columns(width: u16) -> Vec<Column> {
    let full = |column: &Column| match column.name {
        "lost" if width >= 100 => Column { title: "Lost net/rec", width: 12, most: 12, ..*column },
        _ => *column,
    };
    TOPIC_COLUMNS.iter().map(full).collect()
}

pub fn draw_topics(canvas: &mut Canvas, area: Rect, state: &State) {
    let topics = &state.topics;
    let rows = topics.visible();
    let keys: Vec<String> = rows.iter().map(|row| row.topic.clone()).collect();
    let layout = Layout::new(&topic_columns(area.width), Screen::Topics, &topics.table, area.width);
    let mut note = format!("{} of {}, by {}", rows.len(), topics.rows.len(), order(Screen::Topics, &topics.table));
    if !topics.table.marks.is_empty() {
        note.push_str(&format!(", {} marked", topics.table.marks.len()));
    }
    note.push_str(&layout.note());
    let cells = |index: usize| rows.get(index).map_or_else(Vec::new, |row| layout.pick(topic_cells(state, row)));
    let empty = empty(state, Feed::Topics, "No topics published yet; they appear here automatically.");
    let (title, columns) = ("Topics", &layout.columns);
    let sheet = Sheet { title, note, columns, keys: &keys, cells: &cells, table: &topics.table, empty, old: false };
    let narrow = area.width < ALL_FROM;
    draw_table(canvas, Rect { height: area.height - u16::from(narrow), ..area }, &sheet);
    if let Some(selected) = topics.selected().filter(|_| narrow) {
        draw_detail(canvas, row(area, area.height - 1), selected);
    }
}

/// Data that a narrow screen's columns leave out; redrawn at every move of the cursor, so without colours.
fn draw_detail(canvas: &mut Canvas, area: Rect, topic: &TopicRow) {
    let publishers = match topic.publishers.as_slice() {
        [] => "nobody".to_owned(),
        names if topic.pins == 0 => names.join(" "),
        names if topic.unpinned.is_empty() => format!("{} (pinned)", names.join(" ")),
        names => format!("{} (NOT PINNED: {})", names.join(" "), topic.unpinned.join(" ")),
    };
    let last = topic.last_message.map(|last| format!(", last {}", last.clock())).unwrap_or_default();
    let type_name = topic.type_name.as_deref().unwrap_or("type not known yet");
    let lost = topic.lost_in_transport + topic.lost_in_recorder;
    let lost = if lost > 0 { format!(", {} lost", words::count(lost)) } else { String::new() };
    let held = match topic.quarantined {
        0 if topic.alarm => String::from(", ALARM: suspect publisher (enter)"),
        0 => String::new(),
        held => format!(", {} QUARANTINED", words::count(held)),
    };
    let captured = words::count(topic.messages);
    let rule = watch_rule(topic).map(|rule| format!(" ({rule})")).unwrap_or_default();
    let detail = format!("{type_name} from {publishers}: {captured} captured{rule}{held}{lost}{last}");
    canvas.put(area, &detail, Role::Body);
}

/// `by /robot*/odom, at most 5/s, 1,204 left out`; `None` if its own name is watched and every message is kept.
pub fn watch_rule(topic: &TopicRow) -> Option<String> {
    let by = topic.watched_by.as_ref().map(|pattern| format!("by {}", clean(pattern, 255)));
    let kept = (!topic.sampling.is_all()).then(|| topic.sampling.to_string());
    let left_out = (topic.left_out > 0).then(|| format!("{} left out", words::count(topic.left_out)));
    let rule: Vec<String> = [by, kept, left_out].into_iter().flatten().filter(|_| topic.watched).collect();
    (!rule.is_empty()).then(|| rule.join(", "))
}

pub fn empty<'a>(state: &'a State, feed: Feed, nothing: &'a str) -> &'a str {
    match &state.feeds.slot(feed).failure {
        Some(failure) => &failure.message,
        None if state.awaits(feed) && state.site.is_none() => "The site is starting…",
        None if state.awaits(feed) && state.feeds.slot(feed).outstanding => "Asking…",
        None => nothing,
    }
}

fn topic_cells(state: &State, row: &TopicRow) -> Vec<(String, Role)> {
    let lost = format!("{}/{}", row.lost_in_transport, row.lost_in_recorder);
    let any_lost = row.lost_in_transport + row.lost_in_recorder > 0;
    vec![
        (row.topic.clone(), Role::Body),
        (row.type_name.clone().unwrap_or_default(), Role::Dim),
        (row.publishers.join(" "), Role::Dim),
        pinned(row),
        watched_of(state, row),
        (if row.watched { row.sampling.to_string() } else { String::new() }, Role::Body),
        (words::rate(row.hz), Role::Accent),
        (words::kilobytes(row.bytes_per_second), Role::Body),
        (graph::line(&state.topics.samples(&row.topic, SAMPLES, state.shown_at()), CELLS), Role::Accent),
        (words::count(row.messages), Role::Body),
        (lost, if any_lost { Role::Warning } else { Role::Dim }),
        (row.last_message.map(|last| words::age(last, state.shown_at())).unwrap_or_default(), Role::Dim),
        (if row.simulated { "SIM".to_owned() } else { String::new() }, Role::Dim),
        simulated(row.simulated),
    ]
}

pub fn pinned(row: &TopicRow) -> (String, Role) {
    match row {
        TopicRow { pins: 0, .. } => ("-".to_owned(), Role::Dim),
        TopicRow { unpinned, .. } if unpinned.is_empty() => ("pinned".to_owned(), Role::Good),
        _ => ("NOT PINNED".to_owned(), Role::Warning),
    }
}

/// For a folded robot: how many of its topics.
fn watched_of(state: &State, row: &TopicRow) -> (String, Role) {
    let Some(robot) = state.topics.robot(&row.topic) else { return watched(row) };
    let (count, all) = state.topics.watched_of(robot);
    let (word, role) = watched(row);
    if row.watched && !row.alarm && row.held_up.is_none() { (format!("{count} of {all}"), role) } else { (word, role) }
}

pub fn watched(row: &TopicRow) -> (String, Role) {
    match row {
        TopicRow { alarm: true, .. } => ("ALARM".to_owned(), Role::Bad),
        row => (Capture::of(row).word().to_owned(), capture_role(Capture::of(row))),
    }
}

fn capture_role(capture: Capture) -> Role {
    match capture {
        Capture::Watched => Role::Good,
        Capture::WaitsForKey => Role::Warning,
        Capture::Paused => Role::Accent,
        Capture::Unwatched | Capture::NoPublisher => Role::Dim,
    }
}

/// A mark without colour: the colour of warnings is for what is wrong.
pub fn simulated(simulated: bool) -> (String, Role) {
    (if simulated { "SIMULATED".to_owned() } else { String::new() }, Role::Dim)
}

pub(in crate::ui) fn all_columns(screen: Screen) -> Vec<Column> {
    // From this width simulated records are marked in full.
    let (owner, wide) = match screen {
        Screen::Topics => return TOPIC_COLUMNS.to_vec(),
        Screen::Received => (Some(Column::text("Owner", 13).named("owner")), 100),
        _ => (None, 70),
    };
    let rest = [
        Column::name("Topic").named("topic"),
        Column::text("Type", 27).named("type"),
        Column::number("Seq", 7).named("seq"),
        Column::number("Size", 8).named("size"),
        Column::text("UTC", 8).named("time"),
        Column::number("Epoch", 5).named("epoch"),
        Column::number("Block", 8).named("block"),
        Column::text("Id", 16).named("id"),
        Column::text("SM3", 13).named("digest"),
        Column::text("Transaction", 13).named("transaction"),
        Column::text("", 3).below(wide),
        Column::text("", 9).from(wide),
    ];
    [Column::text("State", 11).named("state")].into_iter().chain(owner).chain(rest).collect()
}

pub fn draw_records(canvas: &mut Canvas, area: Rect, state: &State) {
    let screen = state.screen;
    let (title, records, feed) = match screen {
        Screen::Received => ("Received", &state.received, Feed::Received),
        _ => ("Records", &state.records, Feed::Records),
    };
    let nothing = match feed {
        Feed::Received => "Nobody shares with you yet: give others your address (6, then y).",
        _ => "No records yet: watch a topic (2, then w).",
    };
    let slot = state.feeds.slot(feed);
    let rows = records.visible(&state.topics.rows);
    let keys: Vec<String> = rows.iter().map(|row| row.id.clone()).collect();
    let layout = Layout::new(&with_local_time(&all_columns(screen), state), screen, &records.table, area.width);
    let cells = |index: usize| {
        rows.get(index).map_or_else(Vec::new, |row| layout.pick(record_cells(state, row, screen == Screen::Received)))
    };
    let wanted = records.wanted(&state.topics.rows);
    let empty = match &wanted {
        Err(wrong) => wrong.message.as_str(),
        Ok(_) if records.table.filter.text().is_empty() => empty(state, feed, nothing),
        Ok(_) => "No records match the filter.",
    };
    let mut note = wanted.as_ref().map_or_else(|_| "not searched".to_owned(), |wanted| note(records, wanted));
    note.push_str(&layout.note());
    if wanted.is_ok() && (slot.left || slot.told != slot.generation) {
        note.push_str(", reading…");
    }
    let columns = &layout.columns;
    let sheet =
        Sheet { title, note, columns, keys: &keys, cells: &cells, table: &records.table, empty, old: slot.left };
    draw_table(canvas, area, &sheet);
}

fn note(records: &Records, wanted: &Wanted) -> String {
    let order = if records.table.sort == 0 { "newest first" } else { "oldest first" };
    let marked = records.table.marks.len();
    let marked = if marked > 0 { format!("{marked} marked, ") } else { String::new() };
    // The meaning of times comes early: the end of a title is cut.
    let meant = |word: &str, at: Option<Timestamp>| {
        at.map_or_else(String::new, |at| format!("{word} {}, ", records.typed.1.meaning(at)))
    };
    let span = meant("since", wanted.asked.since) + &meant("until", wanted.asked.until);
    let mut note = format!("{marked}{span}{order}, page {}", records.path.len() + 1);
    if let Some(at) = records.anchor {
        note.push_str(&format!(" as of {} (home: newest)", at.clock()));
    }
    if records.next.is_some() {
        note.push_str(", more below");
    }
    if records.arriving {
        note.push_str(", more is arriving from the gateway");
    }
    let asked = &wanted.asked;
    let words = [
        asked.topic.as_ref().map(|topic| format!("only {topic}")),
        asked.type_name.as_ref().map(|name| format!("only {name}")),
        asked.owner.as_ref().map(|owner| format!("of {}", owner.short())),
        asked.kind.map(|kind| format!("only of kind {}", kind.word())),
        asked.robot.as_ref().map(|robot| format!("of robot {robot}")),
    ];
    let searched = asked.words.iter().map(|word| format!("with '{word}'"));
    let tags = asked.tags.iter().map(|(name, value)| format!("tag {name}={value}"));
    for word in words.into_iter().flatten().chain(searched).chain(tags) {
        note.push_str(", ");
        note.push_str(&word);
    }
    if !wanted.rest.is_empty() {
        note.push_str(", ids on this page only");
    }
    note
}

fn record_cells(state: &State, row: &RecordView, with_owner: bool) -> Vec<(String, Role)> {
    let topic = match row.kind {
        RecordKind::Data => row.topic.clone(),
        kind => format!("{} ({})", row.topic, kind.word()),
    };
    let mut cells = vec![(row.state.word().trim_start_matches("waits: ").to_owned(), state_role(row.state))];
    if with_owner {
        let short = || row.owner.map(|owner| owner.short());
        cells.push((row.owner_name.clone().or_else(short).unwrap_or_default(), Role::Accent));
    }
    cells.extend([
        (topic, Role::Body),
        (row.type_name.clone(), Role::Dim),
        (row.seq.to_string(), Role::Body),
        (words::size(row.bytes), Role::Body),
        (state.clock(row.captured_at), Role::Dim),
        (row.epoch.to_string(), Role::Dim),
        (row.block.map(|block| block.to_string()).unwrap_or_default(), Role::Dim),
        (row.id.clone(), Role::Dim),
        (beginning(&row.digest.to_hex()), Role::Dim),
        (row.transaction.map(|hash| beginning(&hash.to_string())).unwrap_or_default(), Role::Dim),
        (if row.simulated { "SIM".to_owned() } else { String::new() }, Role::Dim),
        simulated(row.simulated),
    ]);
    cells
}

/// Enough to compare by eye.
fn beginning(text: &str) -> String {
    text.chars().take(12).chain(['…']).collect()
}

pub fn state_role(state: ShownState) -> Role {
    match state {
        ShownState::Kept(RecordState::Verified) | ShownState::Verified(Caveat::NamesUnchecked) => Role::Good,
        ShownState::Kept(RecordState::Tampered) | ShownState::Refused(_) => Role::Bad,
        ShownState::Kept(RecordState::Quarantined | RecordState::Dropped | RecordState::RightEnded) => Role::Warning,
        ShownState::Kept(_) | ShownState::Verified(Caveat::Deleted | Caveat::Unread) => Role::Accent,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balances_read_as_ether() {
        assert_eq!(ether("0"), "0 wei");
        assert_eq!(ether("1500000000000000000"), "1.500000 ether");
        assert_eq!(ether("1234567890123"), "0.000001 ether");
        assert_eq!(ether("100000000000000000000"), "100.000000 ether");
        assert_eq!(ether("many"), "many wei");
    }
}
