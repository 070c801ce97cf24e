//! Unattended capture from the console: its credential is made and written to a file, and its device is recalled.

use super::action::{Errand, Tag};
use super::exporting;
use super::field::Field;
use super::form::{Form, Line};
use super::popup::{Confirm, Popup, Purpose};
use super::screens::grants::day;
use super::state::State;
use super::when;
use crate::model::{Timestamp, TopicName};
use crate::service::command::{EndUnattended, PrepareUnattended};
use crate::service::reply::{UnattendedState, UnattendedView};

/// The line that asks for a folder.
const FOLDER: usize = 2;
/// The end offered for the loan.
const USUAL_LOAN: &str = "30d";

/// Asks for topics, the end of the loan and a folder.
pub fn begin(state: &mut State) {
    let lines = vec![
        Line::text("Topics", "empty = all watched topics; topic names", Field::default()),
        Line::text("Until", "45m, 12h, 30d, 2036-12-31", Field::offering(USUAL_LOAN)),
        exporting::folder_line(state),
    ];
    let notes = vec![
        "Writes a file with which a site captures while this profile is locked.".to_owned(),
        "It is secret and not encrypted: encrypt it with systemd-creds, then remove it.".to_owned(),
    ];
    let form = Form::new("Prepare unattended capture", notes, lines);
    state.popups.push(Popup::Form(Purpose::Unattended, form));
}

/// The command of a completed form.
///
/// # Errors
/// The field in error, and why.
pub fn read(state: &mut State, form: &Form) -> Result<Errand, (usize, String)> {
    let written = form.text(0).split([' ', ',']).filter(|name| !name.is_empty());
    let topics: Vec<TopicName> =
        written.map(str::parse).collect::<Result<_, _>>().map_err(|error| (0, format!("{error}")))?;
    let until = when::expiry(form.text(1), state.now).map_err(|error| (1, error))?;
    let until = until.ok_or((1, "a loan needs an end: enter a duration (12h, 30d) or a date".to_owned()))?;
    let errand = Errand { command: PrepareUnattended { topics, until }.into(), tag: Tag::PrepareUnattended };
    exporting::goes_to(state, &errand.tag, form, FOLDER);
    Ok(errand)
}

/// Asks before the device is recalled.
pub fn end() -> Confirm {
    let lines = vec![
        "Its device is recalled once its records are anchored: it captures and anchors nothing any more.".to_owned(),
        "A new epoch begins, and current readers keep access. Sends transactions.".to_owned(),
    ];
    let errand = Errand { command: EndUnattended { force: false }.into(), tag: Tag::EndUnattended };
    Confirm { title: "End unattended capture?".to_owned(), lines, yes: "end it", typed: None, errand }
}

/// The credential's state, if this profile has one.
pub fn view(state: &State) -> Option<&UnattendedView> {
    state.site.as_ref()?.unattended.as_ref()
}

/// The badge while a site captures in the name of the locked profile; `long` names the end.
pub fn badge(state: &State, long: bool) -> Option<String> {
    let view = view(state).filter(|view| view.state == UnattendedState::Capturing)?;
    let until = view.until.filter(|_| long).map_or_else(String::new, |until| format!(" until {}", day(until)));
    Some(format!(" UNATTENDED{until} "))
}

/// How it stands, for the screen of keys.
pub fn line(view: &UnattendedView) -> String {
    let until = view.until.map(|until: Timestamp| format!(" until {} UTC", day(until))).unwrap_or_default();
    match view.state {
        UnattendedState::Prepared => format!("prepared{until}; :end-unattended recalls it"),
        UnattendedState::Capturing => format!("capturing{until}"),
        UnattendedState::Ended => {
            let why =
                view.why.as_deref().map_or_else(String::new, |why| format!(": {}", crate::model::clean(why, 200)));
            format!("ended{why}")
        }
        UnattendedState::Attended => "unlocked since: the profile's own keys capture".to_owned(),
    }
}
