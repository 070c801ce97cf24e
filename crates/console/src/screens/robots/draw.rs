//! The Robots screen.

use crate::app::{Feed, Screen, State};
use crate::model::{Timestamp, clean, counted};
use crate::screens::{grants::state::day, robots, robots::state::Member, robots::state::Standing};
use crate::service::reply::{GatewayStatusView, LeaseView, RobotRow, RobotView, SenderView, SystemKeyView};
use crate::ui::{Canvas, Column, Fact, Rect, Role, Sheet, below, draw_facts, empty, row, rows, table, words};

const MOST_REASONS: usize = 4;

/// Nanoseconds.
const DAY: u64 = 86_400_000_000_000;

const COLUMNS: &[Column] = &[
    Column::text("State", 9),
    Column::name("Robot or operator"),
    Column::text("Account", 13),
    Column::text("From", 21).from(90),
    Column::number("Frames", 8),
    Column::number("Bytes", 9),
    Column::text("Since UTC", 9).from(100),
    Column::text("Last UTC", 8),
];

/// If the profile has robots.
const OF_ROBOTS: &[Column] = &[
    Column::text("State", 9),
    Column::name("Robot"),
    Column::text("Last UTC", 8),
    Column::number("Lag", 6).from(70),
    Column::number("Lost", 6).from(70),
    Column::text("Policy", 26),
    Column::number("Waiting", 8).from(100),
    Column::text("Delivers to", 24).from(110),
    Column::number("Bytes", 9).from(150),
];

/// Title and heads of the table; rows of the gateway that stay however many robots there are.
const HEADS: usize = 2;

const LEAST: u16 = 4;

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let Some(view) = &state.gateway.view else {
        canvas.put(area, "Robots and gateway", Role::Title);
        canvas.put(below(area, 1), empty(state, Feed::Gateway, "Asking…"), Role::Dim);
        return;
    };
    let gateway = &state.gateway;
    let all = gateway.all_members().len();
    if view.served.is_none() && all == 0 {
        draw_about(canvas, area, view);
        return;
    }
    let wanted = rows(all.max(1) + HEADS);
    let height = wanted.min(area.height.saturating_sub(LEAST + 1));
    draw_members(canvas, Rect { height, ..area }, state, &gateway.shown());
    draw_about(canvas, below(area, height + 1), view);
}

fn draw_about(canvas: &mut Canvas, area: Rect, view: &GatewayStatusView) {
    canvas.put(area, "Gateway", Role::Title);
    let Some(served) = &view.served else {
        let (first, second) = match &view.through {
            Some(through) => (format!("This site has joined another one: {through}"), "Its gateway is managed there."),
            None => (
                "This site has no gateway.".to_owned(),
                "Start one with `authros gateway serve`; records go straight to store and chain.",
            ),
        };
        canvas.put(row(area, 1), &clean(&first, 300), Role::Body);
        canvas.put(row(area, 2), second, Role::Dim);
        return;
    };
    let mut facts = vec![
        ("Listens", format!("{}, {}", served.address, counted(view.connections, "connection")), Role::Good),
        ("Fingerprint", format!("{} (to be pinned)", served.fingerprint), Role::Body),
        ("Anchors as", served.account.to_string(), Role::Body),
    ];
    facts.extend(view.keys.iter().map(|key| {
        let label = if key.current { "System key" } else { "Next key" };
        (label, system_key(key), Role::Body)
    }));
    facts.extend(view.list_expires.map(|expires| {
        let text = format!("version {}, not valid after {} UTC", view.list_version, day(expires));
        ("Key list", text, Role::Dim)
    }));
    facts.extend(view.lease.as_ref().map(lease));
    facts.extend(refused(view));
    draw_facts(canvas, below(area, 1), &facts);
}

fn lease(lease: &LeaseView) -> Fact {
    let workers = counted(lease.workers.len() as u64, "worker");
    let (text, role) = match &lease.holder {
        Some(holder) if holder.is_own => (format!("held here, {workers}"), Role::Good),
        Some(holder) => (format!("held by {}, {workers}", clean(&holder.name, 120)), Role::Body),
        None => (format!("held by nobody, so nothing is anchored, {workers}"), Role::Warning),
    };
    ("Lease", text, role)
}

fn system_key(key: &SystemKeyView) -> String {
    let id: String = key.id.to_hex().chars().take(16).collect();
    let word = if key.current { "in use" } else { "waits" };
    format!("{id}…  {word}, {} to {} UTC", day(key.not_before), day(key.not_after))
}

fn refused(view: &GatewayStatusView) -> Vec<Fact> {
    if view.refused.is_empty() {
        return vec![("Refused", "none since start".to_owned(), Role::Dim)];
    }
    let mut facts = Vec::new();
    for refused in view.refused.iter().take(MOST_REASONS) {
        let reason = refused.text.split(';').next().unwrap_or_default();
        let label = if facts.is_empty() { "Refused" } else { "" };
        facts.push((label, format!("{:>7}  {reason}", words::count(refused.count)), Role::Warning));
    }
    let more: u64 = view.refused.iter().skip(MOST_REASONS).map(|refused| refused.count).sum();
    if more > 0 {
        facts.push(("", format!("{:>7}  for other reasons (9: audit)", words::count(more)), Role::Dim));
    }
    facts
}

fn draw_members(canvas: &mut Canvas, area: Rect, state: &State, rows: &[Member]) {
    let gateway = &state.gateway;
    let keys: Vec<String> = rows.iter().map(Member::key).collect();
    let senders = gateway.view.as_ref().is_some_and(|view| !view.senders.is_empty());
    let robots = !gateway.robots.is_empty();
    let (title, columns) = match (senders, robots) {
        (true, true) => ("Robots and senders", OF_ROBOTS),
        (false, true) => ("Robots", OF_ROBOTS),
        (_, false) => ("Senders", COLUMNS),
    };
    let order = table::order(Screen::Robots, &gateway.table);
    let mut note = format!("{} of {}", rows.len(), gateway.all_members().len());
    if senders || !robots {
        let connected = rows.iter().filter(|row| row.is_connected()).count();
        note.push_str(&format!(", {connected} connected"));
    }
    note.push_str(&format!(", by {order}"));
    let drift = gateway.robots.iter().filter(|robot| robot.drift).count();
    if drift > 0 {
        note.push_str(&format!(", {drift} out of date"));
    }
    let cells = |index: usize| match rows.get(index) {
        None => Vec::new(),
        Some(row) if robots => cells_of_robots(state, row),
        Some(row) => cells(state, row),
    };
    let empty = match gateway.table.filter.text() {
        "" => "Nobody is enrolled yet; `authros robot enrol` adds a robot or operator.",
        _ => "Nobody matches the filter.",
    };
    let sheet = Sheet { title, note, columns, keys: &keys, cells: &cells, table: &gateway.table, empty, old: false };
    table::draw(canvas, area, &sheet);
}

fn cells(state: &State, row: &Member) -> Vec<(String, Role)> {
    let of = |text: fn(&SenderView) -> String| row.sender.map(text).unwrap_or_default();
    vec![
        standing_now(state, row),
        (row.name(), Role::Body),
        (of(|sender| sender.account.short()), Role::Accent),
        (of(|sender| sender.peer.clone().unwrap_or_default()), Role::Dim),
        (of(|sender| words::count(sender.frames)), Role::Body),
        (of(|sender| words::size(sender.bytes)), Role::Body),
        (of(|sender| sender.since.map(Timestamp::clock).unwrap_or_default()), Role::Dim),
        last(state, row),
    ]
}

fn standing_now(state: &State, row: &Member) -> (String, Role) {
    let word = row.standing(state.shown_at());
    (word.to_owned(), if matches!(word, "connected" | "active") { Role::Good } else { Role::Dim })
}

fn cells_of_robots(state: &State, row: &Member) -> Vec<(String, Role)> {
    let count = |of: fn(&RobotRow) -> u64, role: Role| {
        let count = row.robot.map(of);
        let role = if count.unwrap_or_default() > 0 { role } else { Role::Dim };
        (count.map(words::count).unwrap_or_default(), role)
    };
    let lag = row.last().map(|at| words::age(at, state.shown_at())).unwrap_or_default();
    let address = row.robot.and_then(|robot| robot.address.clone());
    let peer = || row.sender.and_then(|sender| sender.peer.clone()).map(|peer| format!("from {peer}"));
    let bytes = row.sender.map(|sender| words::size(sender.bytes)).unwrap_or_default();
    vec![
        standing_now(state, row),
        (row.name(), Role::Body),
        last(state, row),
        (lag, Role::Body),
        count(|robot| robot.lost, Role::Warning),
        row.robot.map(standing).unwrap_or_default(),
        count(|robot| robot.waiting, Role::Body),
        (address.or_else(peer).unwrap_or_default(), Role::Dim),
        (bytes, Role::Body),
    ]
}

fn last(state: &State, row: &Member) -> (String, Role) {
    (row.last().map(|last| when(last, state.shown_at())).unwrap_or_default(), Role::Dim)
}

/// The clock if within a day, else the age.
fn when(last: Timestamp, now: Timestamp) -> String {
    if now.0.saturating_sub(last.0) < DAY { last.clock() } else { format!("{} ago", words::age(last, now)) }
}

pub fn standing(row: &RobotRow) -> (String, Role) {
    let (mark, role) = match Standing::of(row) {
        Standing::Unset => return (robots::state::words(row), Role::Dim),
        Standing::Wrong => ("✖", Role::Bad),
        Standing::Drifts => ("◐", Role::Warning),
        Standing::InForce => ("●", Role::Good),
    };
    (format!("{mark} {}", robots::state::words(row)), role)
}

pub fn row_facts(row: &RobotRow, now: Timestamp) -> Vec<Fact> {
    let (text, role) = standing(row);
    let wanted = match row.wanted {
        0 => "no policy was set".to_owned(),
        _ => text,
    };
    let mut facts = vec![("policy", wanted, role), runs(row)];
    facts.extend(drift(row, now));
    facts.push(("waiting", format!("{} of it here", counted(row.waiting, "record")), Role::Body));
    facts.push(lost(row));
    facts.extend(row.address.iter().map(|address| ("delivers", format!("to {}", clean(address, 255)), Role::Body)));
    facts
}

fn lost(row: &RobotRow) -> Fact {
    ("lost", counted(row.lost, "message"), if row.lost > 0 { Role::Warning } else { Role::Body })
}

fn runs(row: &RobotRow) -> Fact {
    let text = match row.running {
        None => "it has not reported its policy yet".to_owned(),
        Some(0) => "it runs its own settings only".to_owned(),
        Some(version) => format!("it runs version {version}"),
    };
    ("runs", text, Role::Body)
}

fn drift(row: &RobotRow, now: Timestamp) -> Option<Fact> {
    let since = row.drift_since?;
    Some(("outdated", format!("since {}, for {}", words::second(since), words::age(since, now)), Role::Warning))
}

/// All but its topics and the policy's text.
pub fn facts(view: &RobotView, now: Timestamp) -> Vec<Fact> {
    let row = &view.row;
    let waiting = counted(row.waiting, "record");
    let seen = row.last_seen.map_or_else(
        || "never".to_owned(),
        |at| format!("{}, {} ago; waiting here: {waiting}", words::second(at), words::age(at, now)),
    );
    let (stands, role) = standing(row);
    let policy = match (row.wanted, view.set_at) {
        (0, _) => ("policy", "no policy was set".to_owned(), Role::Dim),
        (_, Some(at)) => ("policy", format!("{stands}; set {}", words::second(at)), role),
        (_, None) => ("policy", stands, role),
    };
    let mut facts = vec![policy, runs(row)];
    facts.extend(drift(row, now));
    facts.extend(view.refused.iter().map(|why| ("refused", format!("it refused: {}", clean(why, 300)), Role::Bad)));
    let overruled = view.overruled.iter();
    facts.extend(overruled.map(|what| ("overruled", format!("on the robot: {}", clean(what, 300)), Role::Body)));
    facts.push(("last seen", seen, Role::Body));
    facts.push(lost(row));
    facts.push(("device", row.device.to_hex(), Role::Dim));
    for address in view.gateway.iter().flat_map(|gateway| &gateway.addresses) {
        facts.push(("gateway", clean(address, 255), Role::Body));
    }
    let enrolled = if view.enrolled.is_empty() { "all topics".to_owned() } else { view.enrolled.join(" ") };
    facts.push(("enrolled", enrolled, Role::Body));
    facts
}
