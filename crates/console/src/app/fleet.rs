//! The fleet on screen: how each other gateway stands; naming one, removing one, and the window with all of it.

use super::action::{Effect, Errand, Tag};
use super::feed::Feed;
use super::field::Field;
use super::form::{Form, Line};
use super::key::Key;
use super::perform::copy;
use super::popup::{Confirm, Popup, Purpose};
use super::popup_keys::scrolled;
use super::screen::Screen;
use super::screens::gateway::{Row, beginning};
use super::state::State;
use crate::model::bytes::unhex;
use crate::model::{SignerId, Timestamp, clean};
use crate::service::command::{AddFellow, RemoveFellow};
use crate::service::reply::{FellowView, FleetView};

/// How often it is asked how the fleet stands while that is on screen, nanoseconds: no event reports it.
const ASKED_EVERY: u64 = 2_000_000_000;
/// Characters of a gateway's key that tell it apart.
const KEY: usize = 8;
/// The longest address.
const LONGEST_ADDRESS: usize = 255;

/// How another gateway stands, the worst first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Standing {
    /// Nothing comes from it now.
    Trouble,
    /// It has not told yet what it holds.
    NotHeard,
    /// So many records that it told of are not here.
    Lacking(u64),
    /// It has not told all yet.
    Reading,
    /// Everything it told of is here.
    Reconciled,
}

impl Standing {
    /// How a gateway stands.
    pub fn of(fellow: &FellowView) -> Self {
        match fellow {
            FellowView { problem: Some(_), .. } => Self::Trouble,
            FellowView { heard: None, .. } => Self::NotHeard,
            FellowView { reconciled: true, .. } => Self::Reconciled,
            FellowView { lacking: 0, .. } => Self::Reading,
            FellowView { lacking, .. } => Self::Lacking(*lacking),
        }
    }

    /// In a word or two.
    pub fn words(self) -> String {
        match self {
            Self::Trouble => "trouble".to_owned(),
            Self::NotHeard => "not heard yet".to_owned(),
            Self::Lacking(records) => format!("lacking {records}"),
            Self::Reading => "reading".to_owned(),
            Self::Reconciled => "reconciled".to_owned(),
        }
    }
}

/// What is done to the fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Deed {
    /// A gateway is named.
    Add {
        /// HOST:PORT.
        address: String,
        /// Its key.
        key: SignerId,
        /// The address it had before, if only that changes.
        before: Option<String>,
    },
    /// It is named no more.
    Remove {
        /// HOST:PORT.
        address: String,
        /// Its key.
        key: SignerId,
    },
}

impl Deed {
    /// What is under way, in words.
    pub fn words(&self) -> String {
        match self {
            Self::Add { address, .. } => format!("adding gateway {address} to the fleet"),
            Self::Remove { address, .. } => format!("removing gateway {address} from the fleet"),
        }
    }

    /// What takes it back.
    pub fn undone(&self) -> Errand {
        match self {
            Self::Add { key, before: Some(before), address } => naming(before.clone(), *key, Some(address.clone())),
            Self::Add { address, key, before: None } => removing(address, *key, &key.to_hex()),
            Self::Remove { address, key } => naming(address.clone(), *key, None),
        }
    }
}

fn naming(address: String, key: SignerId, before: Option<String>) -> Errand {
    let tag = Tag::Fleet(Deed::Add { address: address.clone(), key, before });
    Errand { command: AddFellow { address, key }.into(), tag }
}

fn removing(address: &str, key: SignerId, gateway: &str) -> Errand {
    let tag = Tag::Fleet(Deed::Remove { address: address.to_owned(), key });
    Errand { command: RemoveFellow { gateway: gateway.to_owned() }.into(), tag }
}

/// When it is asked again how the fleet stands, if there is one and it is on screen.
pub fn asked_at(state: &State) -> Option<Timestamp> {
    let slot = state.feeds.slot(Feed::Fleet);
    let waits = slot.loaded && !slot.outstanding && !slot.stale && slot.failure.is_none();
    let seen = state.screen == Screen::Gateway && !state.is_frozen() && !state.gateway.all_fellows().is_empty();
    (seen && waits).then(|| Timestamp(state.gateway.fleet_at.0.saturating_add(ASKED_EVERY)))
}

/// Asks again when it is time.
pub fn tick(state: &mut State) {
    if asked_at(state).is_some_and(|at| at <= state.now) {
        state.feeds.slot_mut(Feed::Fleet).stale = true;
    }
}

/// The beginning of a key, as lists show it.
pub fn short(key: &SignerId) -> String {
    format!("{}…", beginning(&key.to_hex(), KEY))
}

/// The window of one gateway.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FellowWindow {
    /// Its key.
    pub key: SignerId,
    /// First line shown.
    pub scroll: usize,
}

impl FellowWindow {
    /// What is known of it now; `None` = it is not named any more.
    pub fn found<'a>(&self, state: &'a State) -> Option<&'a FellowView> {
        state.gateway.all_fellows().iter().find(|one| one.key == self.key)
    }
}

/// The keys of the window, for the bar.
pub fn hints(state: &State) -> Vec<(&'static str, &'static str)> {
    let changes = (!state.settings.read_only).then_some(("x", "remove"));
    changes.into_iter().chain([("y", "copy key"), ("up down", "scroll"), ("q", "close")]).collect()
}

/// A key while the window is open.
pub fn key(state: &mut State, mut window: FellowWindow, key: Key) -> Vec<Effect> {
    let found = window.found(state).cloned();
    let Some(scroll) = scrolled(window.scroll, key, state.page_rows()) else { return Vec::new() };
    let most = found.as_ref().map_or(0, |one| 16 + one.refused.len() * 2);
    window.scroll = scroll.min(most);
    let copied = window.key.to_hex();
    state.popups.push(Popup::Fellow(window));
    match (key, found) {
        (Key::Char('y'), _) => return vec![copy(state, copied)],
        (Key::Char('x'), Some(one)) if !state.settings.read_only => {
            let question = removal(state, &one);
            state.popups.push(Popup::Confirm(question));
        }
        _ => {}
    }
    Vec::new()
}

/// Asks for a gateway to name.
pub fn begin(state: &mut State) {
    let lines = vec![
        Line::text("Address", "such as 192.0.2.7:7420", Field::default()),
        Line::text("Key", "64 hex characters", Field::default()),
    ];
    let notes = vec![
        "Gateways that name each other exchange what they hold.".to_owned(),
        "Get the key from its keeper: y on their Gateway screen copies it.".to_owned(),
    ];
    state.feeds.slot_mut(Feed::Fleet).stale = true;
    state.popups.push(Popup::Form(Purpose::AddGateway, Form::new("Add a gateway to the fleet", notes, lines)));
}

/// The question after a completed form.
///
/// # Errors
/// The field in error, and why.
pub fn read(state: &State, form: &Form) -> Result<Confirm, (usize, String)> {
    let address = address(form.text(0)).map_err(|error| (0, error))?;
    let key = fingerprint(form.text(1)).map_err(|error| (1, error))?;
    let own = state.gateway.view.as_ref().and_then(|view| view.served.as_ref());
    if own.is_some_and(|own| own.gateway == key) {
        return Err((1, "that is the key of the gateway that runs here; enter the other one's".to_owned()));
    }
    let known = state.gateway.all_fellows().iter().find(|one| one.key == key);
    if known.is_some_and(|one| one.address == address) {
        return Err((0, "this gateway is in the fleet already, at this address; press esc".to_owned()));
    }
    let mut lines = vec![format!("Address  {address}"), format!("Key      {key}")];
    let (title, yes) = match known {
        Some(one) => {
            lines.push(format!("It was named at {}; the new address replaces that one.", clean(&one.address, 255)));
            ("Change this gateway's address?", "change it")
        }
        None => {
            lines.push("Each asks the other for what it lacks, and checks all of it again.".to_owned());
            ("Add this gateway to the fleet?", "add it")
        }
    };
    if let Some(own) = own {
        lines.push("Its keeper has to add yours, too, before anything is exchanged:".to_owned());
        lines.push(format!("authros fleet add {} --gateway-key {}", reached(&own.address), own.gateway));
    }
    let before = known.map(|one| one.address.clone());
    Ok(Confirm { title: title.to_owned(), lines, yes, typed: None, errand: naming(address, key, before) })
}

/// How others reach an address that is listened at: one that stands for all of a machine's is no place to go to.
fn reached(address: &str) -> String {
    let port = ["0.0.0.0:", "[::]:"].iter().find_map(|every| address.strip_prefix(every));
    port.map_or_else(|| clean(address, 255), |port| format!("HOST:{port}"))
}

/// HOST:PORT, as the site takes it.
fn address(text: &str) -> Result<String, String> {
    let text = text.trim();
    let parts = text.rsplit_once(':').filter(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
    let plain = text.len() <= LONGEST_ADDRESS && text.bytes().all(|byte| byte.is_ascii_graphic());
    match parts.filter(|_| plain) {
        Some(_) => Ok(text.to_owned()),
        None => Err("write the address as HOST:PORT, such as 192.0.2.7:7420".to_owned()),
    }
}

/// A gateway's key: the whole of it, with or without spaces.
fn fingerprint(text: &str) -> Result<SignerId, String> {
    let digits: String = text.chars().filter(|character| !character.is_whitespace()).collect();
    unhex(&digits).and_then(|bytes| SignerId::from_slice(&bytes)).ok_or_else(|| match digits.len() {
        0 => "enter its key; its keeper reads it in authros fleet status".to_owned(),
        32 => "that is the short fingerprint; enter the key of 64 hex characters".to_owned(),
        length => format!("a key has 64 hex characters, and this has {length}; copy it whole"),
    })
}

/// Asks before the gateway under the cursor is removed.
pub fn begin_removal(state: &mut State) {
    let Some(Row::Fellow(one)) = state.gateway.selected() else { return };
    let question = removal(state, one);
    state.popups.push(Popup::Confirm(question));
}

fn removal(state: &State, one: &FellowView) -> Confirm {
    let address = clean(&one.address, 255);
    let lines = vec![
        format!("Key      {}", one.key),
        format!("Stands   {}", Standing::of(one).words()),
        "Records are no longer exchanged with it; those already taken stay.".to_owned(),
        "Its keeper may still list yours, and has to remove it there.".to_owned(),
    ];
    // What a person would type, if that names one gateway only.
    let alone = state.gateway.all_fellows().iter().filter(|other| other.address == one.address).count() == 1;
    let gateway = if alone { one.address.clone() } else { one.key.to_hex() };
    let errand = removing(&one.address, one.key, &gateway);
    Confirm { title: format!("Remove gateway {address}?"), lines, yes: "remove", typed: None, errand }
}

/// The fleet is another one now.
pub fn changed(state: &mut State, deed: &Deed, rows: Vec<FellowView>) {
    let before = state.gateway.fleet.take();
    let before = before.unwrap_or(FleetView { address: None, key: None, fellows: Vec::new(), held: 0, copies: None });
    let fleet = FleetView { fellows: rows, ..before };
    let now = state.now;
    state.gateway.set_fleet(fleet, now);
    let text = match deed {
        Deed::Add { address, before: None, .. } => format!("gateway {address} is in the fleet (U: undo)"),
        Deed::Add { address, .. } => format!("this gateway is asked at {address} from now on (U: undo)"),
        Deed::Remove { address, key } => {
            state.popups.retain(|popup| !matches!(popup, Popup::Fellow(window) if window.key == *key));
            format!("gateway {address} is no longer in the fleet (U: undo)")
        }
    };
    state.inform(text);
}
