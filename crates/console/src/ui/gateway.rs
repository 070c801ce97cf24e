//! The Gateway screen: what is served, system keys and their dates, refusals, robots, their policies, and senders.

use ratatui::layout::Rect;

use super::lists::{draw_facts, empty};
use super::table::{Column, Sheet, draw as draw_table, order};
use super::theme::Role;
use super::{Canvas, below, row};
use crate::app::policies::{Standing, words as stands};
use crate::app::screens::{Member, day};
use crate::app::update::Feed;
use crate::app::{Screen, State, counted};
use crate::model::{Timestamp, clean};
use crate::service::reply::{GatewayStatusView, RobotRow, RobotView, SenderView, SystemKeyView};

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
const WITH_POLICY: &[Column] = &[
    Column::text("State", 9),
    Column::name("Robot or operator"),
    Column::text("Policy", 26),
    Column::text("Account", 13).from(100),
    Column::text("From", 21).from(125),
    Column::number("Frames", 8).from(110),
    Column::number("Bytes", 9).from(75),
    Column::text("Last UTC", 8),
];

/// Where no gateway runs: what the owner's site knows.
const OF_OWNER: &[Column] = &[
    Column::name("Robot"),
    Column::text("Policy", 26),
    Column::text("Gateway", 24).from(90),
    Column::number("Waiting", 8),
    Column::text("Last UTC", 8),
];

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let Some(view) = &state.gateway.view else {
        canvas.put(area, "Gateway", Role::Title);
        canvas.put(below(area, 1), empty(state, Feed::Gateway, "Asking…"), Role::Dim);
        return;
    };
    let gateway = &state.gateway;
    let taken = draw_about(canvas, area, view);
    if view.served.is_some() || !gateway.all_members().is_empty() {
        draw_members(canvas, below(area, taken), state, &gateway.shown());
    }
}

/// Returns the rows taken.
fn draw_about(canvas: &mut Canvas, area: Rect, view: &GatewayStatusView) -> u16 {
    canvas.put(area, "Gateway", Role::Title);
    let Some(served) = &view.served else {
        let (first, second) = match &view.through {
            Some(through) => (format!("This site has joined another one: {through}"), "Its gateway is managed there."),
            None => (
                "This site has no gateway.".to_owned(),
                "Records go straight to its store and chain. Start one with: authros gateway serve",
            ),
        };
        canvas.put(row(area, 1), &clean(&first, 300), Role::Body);
        canvas.put(row(area, 2), second, Role::Dim);
        return 4;
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
    facts.extend(refused(view));
    draw_facts(canvas, below(area, 1), &facts) + 2
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
        facts.push((label, format!("{:>7}  {reason}", super::count(refused.count)), Role::Warning));
    }
    let more: u64 = view.refused.iter().skip(MOST_REASONS).map(|refused| refused.count).sum();
    if more > 0 {
        facts.push(("", format!("{:>7}  for other reasons (9: audit)", super::count(more)), Role::Dim));
    }
    facts
}

fn draw_members(canvas: &mut Canvas, area: Rect, state: &State, rows: &[Member]) {
    let gateway = &state.gateway;
    let keys: Vec<String> = rows.iter().map(Member::key).collect();
    let senders = gateway.view.as_ref().is_some_and(|view| !view.senders.is_empty());
    let robots = !gateway.robots.is_empty();
    let (title, columns) = match (senders, robots) {
        (true, true) => ("Robots and senders", WITH_POLICY),
        (false, true) => ("Robots", OF_OWNER),
        (_, false) => ("Senders", COLUMNS),
    };
    let order = order(Screen::Gateway, &gateway.table);
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
        Some(row) if robots && !senders => cells_of_owner(state, row),
        Some(row) => cells(state, row, robots),
    };
    let empty = match gateway.table.filter.text() {
        "" => "Nobody is enrolled yet; `authros agent enrol` adds a robot or operator.",
        _ => "Nobody matches the filter.",
    };
    let sheet = Sheet { title, note, columns, keys: &keys, cells: &cells, table: &gateway.table, empty, old: false };
    draw_table(canvas, area, &sheet);
}

fn cells(state: &State, row: &Member, policy: bool) -> Vec<(String, Role)> {
    let (word, role) = match row.sender {
        None => ("-", Role::Dim),
        Some(sender) if sender.sessions > 0 => ("connected", Role::Good),
        Some(_) => ("away", Role::Dim),
    };
    let of = |text: fn(&SenderView) -> String| row.sender.map(text).unwrap_or_default();
    let mut cells = vec![(word.to_owned(), role), (row.name(), Role::Body)];
    if policy {
        cells.push(row.robot.map(standing).unwrap_or_default());
    }
    cells.extend([
        (of(|sender| sender.account.short()), Role::Accent),
        (of(|sender| sender.peer.clone().unwrap_or_default()), Role::Dim),
        (of(|sender| super::count(sender.frames)), Role::Body),
        (of(|sender| super::size(sender.bytes)), Role::Body),
    ]);
    if !policy {
        cells.push((of(|sender| sender.since.map(Timestamp::clock).unwrap_or_default()), Role::Dim));
    }
    cells.push(last(state, row));
    cells
}

fn cells_of_owner(state: &State, row: &Member) -> Vec<(String, Role)> {
    let waiting = row.robot.map_or(0, |robot| robot.waiting);
    vec![
        (row.name(), Role::Body),
        row.robot.map(standing).unwrap_or_default(),
        (row.robot.and_then(|robot| robot.address.clone()).unwrap_or_else(|| "-".to_owned()), Role::Dim),
        (super::count(waiting), if waiting > 0 { Role::Body } else { Role::Dim }),
        last(state, row),
    ]
}

fn last(state: &State, row: &Member) -> (String, Role) {
    (row.last().map(|last| when(last, state.shown_at())).unwrap_or_default(), Role::Dim)
}

/// The clock if within a day, else the age.
fn when(last: Timestamp, now: Timestamp) -> String {
    if now.0.saturating_sub(last.0) < DAY { last.clock() } else { format!("{} ago", super::age(last, now)) }
}

/// Label, words, role.
pub type Fact = (&'static str, String, Role);

pub fn standing(row: &RobotRow) -> (String, Role) {
    let (mark, role) = match Standing::of(row) {
        Standing::Unset => return (stands(row), Role::Dim),
        Standing::Wrong => ("✖", Role::Bad),
        Standing::Drifts => ("◐", Role::Warning),
        Standing::InForce => ("●", Role::Good),
    };
    (format!("{mark} {}", stands(row)), role)
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
    facts
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
    Some(("outdated", format!("since {}, for {}", super::second(since), super::age(since, now)), Role::Warning))
}

/// All but its topics and the policy's text.
pub fn facts(view: &RobotView, now: Timestamp) -> Vec<Fact> {
    let row = &view.row;
    let waiting = counted(row.waiting, "record");
    let seen = row.last_seen.map_or_else(
        || "never".to_owned(),
        |at| format!("{}, {} ago; {waiting} wait here", super::second(at), super::age(at, now)),
    );
    let (stands, role) = standing(row);
    let policy = match (row.wanted, view.set_at) {
        (0, _) => ("policy", "no policy was set".to_owned(), Role::Dim),
        (_, Some(at)) => ("policy", format!("{stands}; set {}", super::second(at)), role),
        (_, None) => ("policy", stands, role),
    };
    let mut facts = vec![policy, runs(row)];
    facts.extend(drift(row, now));
    facts.extend(view.refused.iter().map(|why| ("refused", format!("it refused: {}", clean(why, 300)), Role::Bad)));
    let overruled = view.overruled.iter();
    facts.extend(overruled.map(|what| ("overruled", format!("on the robot: {}", clean(what, 300)), Role::Body)));
    facts.push(("last seen", seen, Role::Body));
    facts.push(("device", row.device.to_hex(), Role::Dim));
    for address in view.gateway.iter().flat_map(|gateway| &gateway.addresses) {
        facts.push(("gateway", clean(address, 255), Role::Body));
    }
    let enrolled = if view.enrolled.is_empty() { "all topics".to_owned() } else { view.enrolled.join(" ") };
    facts.push(("enrolled", enrolled, Role::Body));
    facts
}
