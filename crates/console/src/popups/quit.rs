//! Leaving: what stops with this console and what continues; now, once all is verified, or after pausing the capture.

use crate::app::{Effect, Errand, Feed, Key, Popup, State, Tag};
use crate::model::counted;
use crate::popups::state::Leaving;
use crate::screens::{topics, topics::capture::not_captured};
use crate::service::Command;
use crate::ui::{Canvas, Rect, Role, draw_text};

/// Whether the site ends with this console.
fn ends(state: &State) -> bool {
    !matches!(Standing::of(state), Some(Standing::Joined(_)))
}

/// Whether verifying everything requires pausing the capture first.
fn can_drain(state: &State) -> bool {
    ends(state) && topics::capture::captured(state).is_some()
}

fn capture_lines(state: &State) -> Vec<String> {
    let site = match Standing::of(state) {
        Some(Standing::Joined(0)) | None => "in the site".to_owned(),
        Some(Standing::Joined(process)) => format!("in the site (process {process})"),
        Some(Standing::Host) => String::new(),
    };
    let mut lines: Vec<String> = match topics::capture::captured(state) {
        Some(what) if ends(state) => vec![
            format!("Quitting stops {what}."),
            if state.settings.tour.is_some() {
                "The tour ends, and its temporary home is removed with all that is in it.".to_owned()
            } else if can_leave_site(state) {
                "s: `authros serve` continues it after a gap of a few seconds; asks for the passphrase.".to_owned()
            } else {
                "To keep it running without a console, use `authros serve`".to_owned()
            },
        ],
        Some(what) => vec![format!("{} continues {site}.", sentence(&what))],
        None => Vec::new(),
    };
    lines.extend(not_captured(state).map(|what| format!("{} anyway.", sentence(&what))));
    lines
}

fn record_lines(state: &State) -> Vec<String> {
    let records = match state.pending_records() {
        0 => return Vec::new(),
        1 => "1 record is not verified yet".to_owned(),
        more => format!("{} are not verified yet", counted(more, "record")),
    };
    if !ends(state) {
        return vec![format!("{records}; the site continues with them.")];
    }
    let safe = "They are safe on disk and continue at the next start.".to_owned();
    [format!("{records}.")].into_iter().chain(state.settings.tour.is_none().then_some(safe)).collect()
}

impl Leaving {
    pub fn lines(self, state: &State) -> Vec<String> {
        let mut lines = if self == Self::Held { Vec::new() } else { capture_lines(state) };
        lines.extend(record_lines(state));
        lines
            .extend(state.work.iter().filter(|tag| tag.is_work()).map(|tag| format!("Still running: {}", tag.words())));
        if lines.is_empty() {
            lines.push("Nothing is pending any more.".to_owned());
        }
        match self {
            Self::Asked => {}
            Self::WhenVerified => lines.push("Quitting when everything is verified…".to_owned()),
            Self::Held => lines.push("Capture is stopped. Quitting when everything is verified…".to_owned()),
        }
        lines
    }

    pub fn hints(self, state: &State) -> Vec<(&'static str, &'static str)> {
        let mut hints = vec![("y", "quit now")];
        if self == Self::Asked && can_drain(state) {
            hints.push(("d", "stop capture, finish, quit"));
            hints.extend(can_leave_site(state).then_some(("s", "leave it running")));
        } else if self == Self::Asked && state.has_pending_work() {
            hints.push(("w", "quit when verified"));
        }
        hints.push(("esc", "stay"));
        hints
    }
}

/// Whether a site can continue after this console.
fn can_leave_site(state: &State) -> bool {
    let is_host = matches!(Standing::of(state), Some(Standing::Host));
    is_host && state.settings.leaves_site && state.identity.as_ref().is_some_and(|identity| identity.exists)
}

/// Whether quitting now stops something or leaves it undone.
pub fn asks(state: &State) -> bool {
    state.has_pending_work() || can_drain(state)
}

pub fn key(state: &mut State, leaving: Leaving, key: Key) {
    match key {
        Key::Char('y') | Key::Control('c') => state.effects.push(Effect::Quit),
        Key::Char('d') if leaving == Leaving::Asked && can_drain(state) => {
            state.popups.push(Popup::Quit(Leaving::Held));
            hold(state, true);
        }
        Key::Char('s') if leaving == Leaving::Asked && can_drain(state) && can_leave_site(state) => {
            state.effects.push(Effect::LeaveSite);
        }
        Key::Char('w') if leaving == Leaving::Asked && !can_drain(state) => {
            state.popups.push(Popup::Quit(Leaving::WhenVerified));
        }
        Key::Char('?') => state.popups.push(Popup::Quit(leaving)),
        _ if leaving == Leaving::Held => hold(state, false),
        _ => {}
    }
}

fn hold(state: &mut State, hold: bool) {
    state.send(Errand { command: Command::HoldCapture { hold }, tag: Tag::HoldCapture });
}

pub fn is_over(state: &State) -> bool {
    let site = state.feeds.slot(Feed::Site);
    let known = !site.stale && !site.outstanding;
    match state.popups.last() {
        Some(Popup::Quit(Leaving::WhenVerified)) => !state.has_pending_work(),
        Some(Popup::Quit(Leaving::Held)) => known && !state.has_pending_work() && waiting(state) == 0,
        _ => false,
    }
}

/// Messages in memory that are not records yet; those of other profiles do not block leaving.
fn waiting(state: &State) -> u64 {
    state.site.as_ref().filter(|site| site.profiles.len() <= 1).map_or(0, |site| site.queue.messages)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// In this process; it ends with the console.
    Host,
    /// In another process; 0 = one that does not report its number.
    Joined(u32),
}

impl Standing {
    /// `None` = the site has not answered yet.
    pub fn of(state: &State) -> Option<Self> {
        let process = state.site.as_ref()?.process;
        Some(if process == state.settings.process { Self::Host } else { Self::Joined(process) })
    }

    pub fn badge(self) -> String {
        match self {
            Self::Host => "HOST".to_owned(),
            Self::Joined(0) => "JOINED".to_owned(),
            Self::Joined(process) => format!("JOINED {process}"),
        }
    }
}

/// Upper-cases the first letter.
pub fn sentence(text: &str) -> String {
    let mut characters = text.chars();
    characters.next().map_or_else(String::new, |first| first.to_uppercase().chain(characters).collect())
}

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, leaving: Leaving) {
    let hints = leaving.hints(state);
    // Four hints fit 80 columns only with narrow gaps.
    let gap = if hints.len() > 3 { "  " } else { "    " };
    let answer: Vec<(&str, Role)> = hints
        .iter()
        .flat_map(|(key, word)| [(*key, Role::Key), (" ", Role::Body), (*word, Role::Body), (gap, Role::Body)])
        .collect();
    draw_text(canvas, area, "Quit?", &leaving.lines(state), &answer);
}
