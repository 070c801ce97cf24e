//! Grants: forms filled from the selected row, terms checked before the question.

use crate::app::{
    Confirm, Errand, Feed, Field, Form, Line, Need, Popup, Purpose, Screen, State, Tag, Wrong, completion,
    form::ALL_TOPICS, form::OF_ROBOT, identity_path, when,
};
use crate::model::{Address, Direction, Party, Timestamp, TopicName, TopicPattern, grant::MOST_TOPICS};
use crate::screens::grants::state::{day, end, is_active, is_given, other_side, scope};
use crate::screens::{grants, robots};
use crate::service::reply::{GrantForesight, GrantRow, NOTHING_OLDER, Opens, RobotRow};
use crate::service::{Command, Failure, GrantFrom};

const GRANTEE: usize = 0;
const TOPICS: usize = 1;

/// Fills the form from the cursor; marked topics take precedence over the selected one.
pub fn begin(state: &mut State) {
    let (grantee, topics) = match state.screen {
        Screen::Topics => (String::new(), state.topics.targets().into_iter().map(|row| row.topic.clone()).collect()),
        Screen::Grants => state.grants.selected().map_or_else(Default::default, terms),
        Screen::Robots => (String::new(), robots::keys::under_cursor(state).map(of_robot).into_iter().collect()),
        _ => (String::new(), Vec::new()),
    };
    open(state, &grantee, &topics, "");
}

fn of_robot(row: &RobotRow) -> String {
    format!("{OF_ROBOT}{}", row.name)
}

fn terms(row: &GrantRow) -> (String, Vec<String>) {
    let grantee = row.name.clone().unwrap_or_else(|| other_side(row).to_string());
    let topics = match is_given(row) {
        true if row.topics.is_empty() => vec![ALL_TOPICS.to_owned()],
        true => row.topics.clone(),
        false => Vec::new(),
    };
    (grantee, topics)
}

pub fn open(state: &mut State, grantee: &str, topics: &[String], ends: &str) {
    state.feeds.slot_mut(Feed::Contacts).stale = true;
    // The form shows how many records a grant opens now.
    state.feeds.slot_mut(Feed::Identity).stale = true;
    state.popups.push(Popup::Form(Purpose::Grant, grant_form(grantee, topics, ends, moments(state))));
}

/// What the words of the line `From` mean now.
pub fn moments(state: &State) -> Vec<String> {
    let known = |opens: Option<Opens>, else_: &str| match opens {
        Some(Opens { since: None, .. }) => "no record yet".to_owned(),
        Some(opens) => format!("{} of all topics", opens.words(|moment| state.times().meaning(moment))),
        None => else_.to_owned(),
    };
    let identity = state.identity.as_ref();
    let current = known(identity.and_then(|identity| identity.epoch_records), "since the current epoch began");
    let all = known(identity.and_then(|identity| identity.all_records), "all records, of every epoch");
    vec![
        "now    from now on: a new key, nothing older".to_owned(),
        format!("epoch  {current}"),
        format!("start  {all}"),
        "1h     what was captured since, by whole epochs".to_owned(),
    ]
}

/// `grant bob /robot1/odom 30d` of the palette: the form with these terms.
pub fn spoken(state: &mut State, words: &[&str]) {
    let Some((grantee, rest)) = words.split_first() else { return };
    let is_topic = |word: &&str| word.starts_with('/') || word.starts_with(OF_ROBOT) || *word == ALL_TOPICS;
    let (topics, ends): (Vec<&str>, Vec<&str>) = rest.iter().copied().partition(is_topic);
    let topics: Vec<String> = topics.into_iter().map(str::to_owned).collect();
    open(state, grantee, &topics, &ends.join(" "));
    if let Some(Popup::Form(Purpose::Grant, form)) = state.popups.last_mut().filter(|_| !topics.is_empty()) {
        // Only the moment is left, preset to the safest one: Enter goes on to the question.
        form.focus = form.lines.len().saturating_sub(1);
    }
}

/// Refuses unknown names, and accounts with an active grant on the same terms.
pub fn check(state: &State, wish: &GrantWish) -> Result<(), Wrong> {
    let known = state.feeds.slot(Feed::Contacts).loaded;
    let name = wish.grantee.to_string();
    let contact = state.contacts.iter().find(|row| row.name.to_string() == name);
    if known && wish.grantee.address().is_none() && contact.is_none() {
        return Err((GRANTEE, format!("no contact is named '{name}'; tab completes names")));
    }
    if standing(state, wish).is_some_and(|row| same_terms(state, row, wish)) {
        return Err((GRANTEE, "already has an active grant on these terms".to_owned()));
    }
    Ok(())
}

fn same_terms(state: &State, row: &GrantRow, wish: &GrantWish) -> bool {
    let mut wanted: Vec<String> = wish.topics.iter().map(ToString::to_string).collect();
    let mut given = row.topics.clone();
    wanted.sort();
    given.sort();
    wish.robots.is_empty() && wanted == given && wish.expires == row.expires && opens_the_same(state, row, wish.from)
}

/// Nothing more than the grant opens already.
fn opens_the_same(state: &State, row: &GrantRow, from: GrantFrom) -> bool {
    let current = state.identity.as_ref().and_then(|identity| identity.epoch);
    match from {
        GrantFrom::Now => true,
        GrantFrom::Current => row.from == current,
        GrantFrom::Epoch(epoch) => row.from == Some(epoch),
        GrantFrom::Time(_) => false,
    }
}

/// Asks, and requests what the grant would open and cost; the question is completed by the answer.
pub fn ask(state: &mut State, mut wish: GrantWish) {
    if let (GrantFrom::Current, Some(_)) = (wish.from, standing(state, &wish)) {
        // The revoke begins another one.
        let current = state.identity.as_ref().and_then(|identity| identity.epoch);
        wish.from = current.map_or(wish.from, GrantFrom::Epoch);
    }
    let GrantWish { grantee, topics, robots, from, .. } = wish.clone();
    let tag = foresight(&wish);
    let (question, follow_up) = question(state, wish, None);
    state.follow_up = follow_up;
    state.popups.push(Popup::Confirm(question));
    if state.identity.as_ref().is_some_and(|identity| identity.unlocked && identity.registered) {
        let topics = topics.into_iter().map(Into::into).collect();
        state.send_new(Errand { command: Command::ForeseeGrant { grantee, topics, robots, from }, tag });
    }
}

fn standing<'a>(state: &'a State, wish: &GrantWish) -> Option<&'a GrantRow> {
    let name = wish.grantee.to_string();
    let contact = state.contacts.iter().find(|row| row.name.to_string() == name).map(|row| row.address);
    active(state, wish.grantee.address().or(contact), &name)
}

/// As typed: topics by name, robots by theirs.
pub fn covered(wish: &GrantWish) -> Vec<String> {
    let robots = wish.robots.iter().map(|robot| format!("{OF_ROBOT}{robot}"));
    wish.topics.iter().map(ToString::to_string).chain(robots).collect()
}

fn foresight(wish: &GrantWish) -> Tag {
    let topics: Vec<String> = covered(wish);
    Tag::Foresee(format!("{} from {} on {}", wish.grantee, wish.from, topics.join(" ")))
}

/// Revokes an active grant to the account first, and grants after that; one question covers both acts.
fn question(
    state: &State,
    wish: GrantWish,
    foreseen: Option<Result<GrantForesight, Failure>>,
) -> (Confirm, Option<(Tag, Errand)>) {
    let standing = standing(state, &wish);
    let mut question = plain_question(state, wish, foreseen);
    let Some(row) = standing else { return (question, None) };
    let tag = Tag::Revoke(row.grantee);
    let revoke = Errand { command: Command::Revoke { grantee: row.grantee.into() }, tag: tag.clone() };
    let before = [
        format!("Now      {}, {}", scope(&row.topics), end(row.expires)),
        "That grant is revoked first, then a new one is made; in between, and if".to_owned(),
        "the second transaction fails, this account reads nothing.".to_owned(),
        String::new(),
    ];
    question.lines.splice(0..0, before);
    "Revoke and grant again?".clone_into(&mut question.title);
    question.yes = "revoke and grant";
    let grant = std::mem::replace(&mut question.errand, revoke);
    (question, Some((tag, grant)))
}

/// Completes the question that this was asked for, if it is still open.
pub fn answered(state: &mut State, tag: &Tag, answer: Result<GrantForesight, Failure>) {
    let place = state.popups.iter().rposition(|popup| matches!(popup, Popup::Confirm(_)));
    let Some(Popup::Confirm(confirm)) = place.and_then(|place| state.popups.get(place)) else { return };
    let asked = match (&confirm.errand.command, &state.follow_up) {
        (Command::Revoke { .. }, Some((_, after))) => &after.command,
        (command, _) => command,
    };
    let Some(wish) = wish_of(asked).filter(|wish| foresight(wish) == *tag) else { return };
    let (question, _) = question(state, wish, Some(answer));
    // The list of grants may have changed: the acts are still those that were asked about.
    if let Some(Popup::Confirm(confirm)) = place.and_then(|place| state.popups.get_mut(place))
        && confirm.errand.tag == question.errand.tag
    {
        confirm.lines = question.lines;
    }
}

fn wish_of(command: &Command) -> Option<GrantWish> {
    let Command::Grant { grantee, topics, robots, from, expires } = command else { return None };
    let topics = topics.iter().filter_map(TopicPattern::name).collect();
    Some(GrantWish { grantee: grantee.clone(), topics, robots: robots.clone(), from: *from, expires: *expires })
}

fn active<'a>(state: &'a State, address: Option<Address>, name: &str) -> Option<&'a GrantRow> {
    let is_it = |row: &&GrantRow| Some(row.grantee) == address || row.name.as_deref() == Some(name);
    state.grants.rows.iter().filter(|row| is_given(row) && is_active(row)).find(is_it)
}

/// What deserves a second look: sharing everything, or an unknown topic.
pub fn caution(state: &State, command: &Command) -> Option<String> {
    if let (Command::Revoke { .. }, Some((_, after))) = (command, &state.follow_up) {
        return caution(state, &after.command);
    }
    let Command::Grant { topics, robots, .. } = command else { return None };
    if topics.is_empty() && robots.is_empty() {
        return Some("ALL topics: whatever you publish now and later.".to_owned());
    }
    let known = |topic: &TopicPattern| state.topics.rows.iter().any(|row| topic.matches(&row.topic));
    let unknown: Vec<&str> = topics.iter().filter(|topic| !known(topic)).map(TopicPattern::as_str).collect();
    let loaded = state.feeds.slot(Feed::Topics).loaded;
    (loaded && !unknown.is_empty()).then(|| format!("No topic of this name is known here: {}", unknown.join(" ")))
}

/// False if there is nothing to complete.
pub fn complete(state: &State, form: &mut Form) -> bool {
    let names: Vec<String> = match form.focus {
        GRANTEE => state.contacts.iter().map(|row| row.name.to_string()).collect(),
        TOPICS => {
            let topics = state.topics.rows.iter().map(|row| row.topic.clone());
            topics.chain(state.gateway.robots.iter().map(of_robot)).chain([ALL_TOPICS.to_owned()]).collect()
        }
        _ => return false,
    };
    completion::complete_from(form, &names)
}

pub fn begin_extension(state: &mut State) {
    let Some(row) = state.grants.selected() else { return };
    let who = row.name.clone().unwrap_or_else(|| row.grantee.short());
    let ends = row.expires.map_or_else(|| "never".to_owned(), day);
    state.popups.push(Popup::Form(Purpose::Extend, extend_form(&who, &ends)));
}

/// A later end is the contract's; a sooner one is a revoke and a new grant.
pub fn extend(state: &mut State, form: &Form) -> Result<(), Wrong> {
    let row = state.grants.selected().filter(|row| is_given(row) && is_active(row));
    let row = row.ok_or((0, "this grant is no longer active".to_owned()))?;
    let expires = when::expiry(form.text(0), &state.times()).map_err(|error| (0, error))?;
    if expires.is_none() && row.expires.is_none() {
        return Err((0, "it already has no end; enter a time to end it then".to_owned()));
    }
    if expires.is_some_and(|wanted| row.expires.is_none_or(|now| wanted <= now)) {
        let wish = sooner(row, expires)?;
        ask(state, wish);
    } else {
        let command = Command::ExtendGrant { grantee: Party::from(row.grantee), expires };
        let errand = Errand { command, tag: Tag::Extend(row.grantee) };
        identity_path::run(state, Need::Registered, vec![errand]);
    }
    Ok(())
}

fn sooner(row: &GrantRow, expires: Option<Timestamp>) -> Result<GrantWish, Wrong> {
    let topics: Result<Vec<TopicName>, _> = row.topics.iter().map(|topic| topic.parse()).collect();
    let topics =
        topics.map_err(|_| (0, "one of its topics is unknown here by name; revoke it and grant again".to_owned()))?;
    // What it opens stays the same.
    let from = GrantFrom::Epoch(row.from.unwrap_or(row.epoch));
    Ok(GrantWish { grantee: row.grantee.into(), topics, robots: Vec::new(), from, expires })
}

const ENDS: &str = "empty = never; 30d, 18:00, tomorrow 18:00";

/// Focuses the first empty line; `moments` says what the words of the line `From` mean now.
pub fn grant_form(grantee: &str, topics: &[String], ends: &str, moments: Vec<String>) -> Form {
    let lines = vec![
        Line::text("Address", "0x and 40 hex, or a contact's name", Field::offering(grantee)),
        Line::text("Topics", "topic names; robot:scout-1; all", Field::offering(&topics.join(" "))),
        Line::text("Ends", ENDS, Field::offering(ends)).time(Direction::Ahead),
        Line::text("From", "now, epoch, start; 1h, yesterday 18:00", Field::offering("now")).time(Direction::Back),
    ];
    let mut notes = vec!["Lets another account read your records. Tab completes names.".to_owned()];
    notes.extend(moments);
    let mut form = Form::new("Grant", notes, lines);
    form.focus = usize::from(!grantee.is_empty() && topics.is_empty());
    form
}

pub fn extend_form(grantee: &str, ends: &str) -> Form {
    let lines = vec![Line::text("Ends", ENDS, Field::default()).time(Direction::Ahead)];
    let notes = vec![
        format!("{grantee} can read until: {ends}"),
        "Later: one transaction. Sooner: a revoke and a new grant of the same records.".to_owned(),
    ];
    Form::new("Change the end of the grant", notes, lines)
}

#[derive(Debug, Clone)]
pub struct GrantWish {
    pub grantee: Party,
    /// Both empty = all.
    pub topics: Vec<TopicName>,
    pub robots: Vec<String>,
    pub from: GrantFrom,
    pub expires: Option<Timestamp>,
}

pub fn read_grant(form: &Form, state: &State) -> Result<GrantWish, Wrong> {
    let grantee: Party = form.parsed(0)?;
    if grantee.address().is_some_and(|address| Some(address) == state.address()) {
        return Err((0, "that is your own address; enter the reader's".to_owned()));
    }
    let topics = form.topics(1, &state.topics.rows)?;
    let robots: Vec<String> = form.words(1).filter_map(|word| word.strip_prefix(OF_ROBOT)).map(str::to_owned).collect();
    let (all, none) = (form.words(1).any(|word| word == ALL_TOPICS), topics.is_empty() && robots.is_empty());
    if robots.iter().any(String::is_empty) {
        return Err((1, format!("write the robot's name after {OF_ROBOT} without a space; tab completes it")));
    }
    if none && !all {
        return Err((1, format!("enter topics, or '{ALL_TOPICS}' for every topic")));
    }
    if topics.len() > MOST_TOPICS {
        return Err((1, format!("a grant covers at most {MOST_TOPICS} topics, or all")));
    }
    if !none && all {
        return Err((1, format!("use either '{ALL_TOPICS}' or topic names, not both")));
    }
    let expires = when::expiry(form.text(2), &state.times()).map_err(|error| (2, error))?;
    let from =
        GrantFrom::read(form.text(3), |text| state.times().back(text)).map_err(|failure| (3, failure.message))?;
    Ok(GrantWish { grantee, topics, robots, from, expires })
}

/// `None` = what it opens and costs is not told yet.
pub fn plain_question(state: &State, wish: GrantWish, foreseen: Option<Result<GrantForesight, Failure>>) -> Confirm {
    // What robots have is known once it is foreseen.
    let topics: Vec<String> = match &foreseen {
        Some(Ok(foreseen)) if !wish.robots.is_empty() => foreseen.topics.iter().map(ToString::to_string).collect(),
        _ => covered(&wish),
    };
    let (records, cost) = match &foreseen {
        Some(Ok(foreseen)) => (foreseen.moment(|moment| state.times().meaning(moment)), Some(foreseen.cost())),
        Some(Err(failure)) => (before(wish.from).to_owned(), Some(format!("not known: {}", failure.message))),
        None => (before(wish.from).to_owned(), None),
    };
    let ends = wish.expires.map_or_else(|| "no end".to_owned(), |moment| state.times().meaning(moment));
    let mut lines = vec![
        format!("To       {}", wish.grantee),
        format!("Topics   {}", if topics.is_empty() { scope(&topics) } else { topics.join(" ") }),
        format!("Records  {records}"),
        format!("Ends     {ends}"),
    ];
    lines.extend(cost.map(|cost| format!("Cost     {cost}")));
    lines.push(String::new());
    lines.extend(grants::keys::readers(state, "Current readers:", None));
    lines.push("A later revoke stops new records; what was read cannot be taken back.".to_owned());
    let GrantWish { grantee, topics, robots, from, expires } = wish;
    let topics = topics.into_iter().map(Into::into).collect();
    let tag = Tag::Grant(grantee.clone());
    let errand = Errand { command: Command::Grant { grantee, topics, robots, from, expires }, tag };
    Confirm { title: "Grant this?".to_owned(), lines, yes: "grant", typed: None, errand }
}

/// What is certain before the site has counted.
fn before(from: GrantFrom) -> &'static str {
    match from {
        GrantFrom::Now => NOTHING_OLDER,
        GrantFrom::Current => "since the current epoch began",
        GrantFrom::Epoch(1) => "all, from the first epoch on",
        GrantFrom::Epoch(_) => "since an earlier epoch began",
        GrantFrom::Time(_) => "since the epoch of that time began",
    }
}
