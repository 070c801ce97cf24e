//! The meaning of a typed line: words for keys, first for the popup over the screen, then for the screen.

use zeroize::Zeroizing;

use crate::app::form::{Form, Input};
use crate::app::popup::Popup;
use crate::app::popup_keys::hints;
use crate::app::verb::VERBS;
use crate::app::{Action, Key, Screen, State, Verb};

/// A parsed line.
#[derive(Debug)]
pub enum Meaning {
    /// These actions, one after the other.
    Actions(Vec<Action>),
    /// The screen is read.
    Show,
    /// The parts are read.
    Status,
    /// The words are read.
    Help,
    /// The row at that place is selected.
    Row(usize),
    /// It has no meaning; these words would.
    Unknown(String),
}

/// The present meaning of `line`.
pub fn meaning(state: &State, line: &str) -> Meaning {
    match state.popups.last() {
        Some(Popup::Form(_, form)) => Meaning::Actions(answer(form, line)),
        Some(Popup::Confirm(confirm)) if confirm.typed.is_some() => Meaning::Actions(typed(line.trim())),
        Some(popup) => over(state, popup, line.trim()),
        None => command(state, line.trim()),
    }
}

/// Whether the next line is a secret.
pub fn is_secret(state: &State) -> bool {
    let Some(Popup::Form(_, form)) = state.popups.last() else { return false };
    form.field(form.focus).is_some_and(crate::app::field::Field::is_masked)
}

fn keys(keys: &[Key]) -> Vec<Action> {
    keys.iter().copied().map(Action::Key).collect()
}

fn answer(form: &Form, line: &str) -> Vec<Action> {
    if line.trim() == "esc" {
        return keys(&[Key::Escape]);
    }
    let mut actions = Vec::new();
    match form.lines.get(form.focus).map(|line| &line.input) {
        Some(Input::Choice { options, chosen }) => {
            let count = options.len().max(1);
            let said = line.trim();
            let wanted = said.parse::<usize>().ok().and_then(|number| number.checked_sub(1));
            let named = || {
                options
                    .iter()
                    .position(|word| !said.is_empty() && word.to_lowercase().starts_with(&said.to_lowercase()))
            };
            let steps = wanted
                .filter(|place| *place < count)
                .or_else(named)
                .map_or(0, |place| (place + count - chosen) % count);
            actions.extend(keys(&vec![Key::Right; steps]));
        }
        _ if line.is_empty() => {}
        _ => {
            actions.push(Action::Key(Key::Control('u')));
            actions.push(Action::Paste(Zeroizing::new(line.to_owned())));
        }
    }
    actions.push(Action::Key(Key::Enter));
    actions
}

/// The word required by a grave act.
fn typed(line: &str) -> Vec<Action> {
    if matches!(line, "" | "no" | "esc") {
        return keys(&[Key::Escape]);
    }
    let word = line.chars().map(Key::Char);
    [Key::Control('u')].into_iter().chain(word).chain([Key::Enter]).map(Action::Key).collect()
}

/// A word for a popup: a key of its bar, or what that key does.
fn over(state: &State, popup: &Popup, line: &str) -> Meaning {
    let hints = hints(state, popup);
    let said = line.to_lowercase();
    let hinted = hints.iter().find(|(key, label)| *key == line || (!said.is_empty() && label.to_lowercase() == said));
    let key = match (hinted, said.as_str()) {
        (Some((key, _)), _) if Key::from_label(key).is_some() => Key::from_label(key),
        (_, "yes" | "y") => Some(Key::Char('y')),
        (_, "up") => Some(Key::Up),
        (_, "down") => Some(Key::Down),
        (Some(_), _) | (_, "" | "no" | "n" | "esc" | "close" | "q") => Some(Key::Escape),
        _ => None,
    };
    match key {
        Some(key) => Meaning::Actions(keys(&[key])),
        None if matches!(popup, Popup::Confirm(_) | Popup::Quit(_)) => Meaning::Unknown(words(state, popup)),
        // A popup that is only read gives way to the next command.
        None => match command(state, line) {
            Meaning::Actions(mut actions) => {
                actions.insert(0, Action::Key(Key::Escape));
                Meaning::Actions(actions)
            }
            other => other,
        },
    }
}

/// The words for the popup over the screen.
pub fn words(state: &State, popup: &Popup) -> String {
    let known: Vec<String> = hints(state, popup)
        .iter()
        .filter(|(key, _)| *key != "up down")
        .map(
            |(key, label)| {
                if key.contains(' ') { format!("anything else: {label}") } else { format!("{key}: {label}") }
            },
        )
        .collect();
    known.join(", ")
}

fn command(state: &State, line: &str) -> Meaning {
    let (word, rest) = line.split_once(' ').map_or((line, ""), |(word, rest)| (word, rest.trim()));
    let word = word.to_lowercase();
    match (word.as_str(), rest) {
        ("" | "show", _) => return Meaning::Show,
        ("status", _) => return Meaning::Status,
        ("help" | "?", _) => return Meaning::Help,
        ("row", wanted) => return row(state, wanted),
        ("filter" | "/", text) => {
            let mut actions = vec![Action::Do(Verb::Filter), Action::Key(Key::Control('u'))];
            actions.push(Action::Paste(Zeroizing::new(text.to_owned())));
            actions.push(Action::Key(Key::Enter));
            return Meaning::Actions(actions);
        }
        _ => {}
    }
    let screen = Screen::ALL
        .into_iter()
        .find(|screen| screen.title().to_lowercase() == word || (screen.index() + 1).to_string() == word);
    if let Some(screen) = screen {
        return Meaning::Actions(vec![Action::Do(Verb::Go(screen))]);
    }
    verb(&word).map_or_else(Meaning::Unknown, |verb| Meaning::Actions(vec![Action::Do(verb)]))
}

/// A verb by its full name, or by an unambiguous prefix.
fn verb(word: &str) -> Result<Verb, String> {
    if let Some(entry) = VERBS.iter().find(|entry| entry.name == word) {
        return Ok(entry.verb);
    }
    let mut begun: Vec<_> = VERBS.iter().filter(|entry| entry.name.starts_with(word)).collect();
    begun.dedup_by_key(|entry| entry.verb);
    match begun.as_slice() {
        [entry] => Ok(entry.verb),
        [] => Err(format!("'{word}' is not a command here; help lists them all")),
        several => {
            let names: Vec<&str> = several.iter().map(|entry| entry.name).collect();
            Err(format!("'{word}' could mean {}", names.join(" or ")))
        }
    }
}

fn row(state: &State, wanted: &str) -> Meaning {
    let keys = state.row_keys();
    let number = wanted.parse::<usize>().ok().and_then(|number| number.checked_sub(1));
    let named =
        || keys.iter().position(|key| key == wanted).or_else(|| keys.iter().position(|key| key.contains(wanted)));
    match number.filter(|place| *place < keys.len()).or_else(|| if wanted.is_empty() { None } else { named() }) {
        Some(place) => Meaning::Row(place),
        None => Meaning::Unknown(format!("there is no row '{wanted}'; show lists them")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::tests::Robot;

    fn does(robot: &mut Robot, line: &str) {
        match meaning(&robot.state, line) {
            Meaning::Actions(actions) => actions.into_iter().for_each(|action| robot.act(action)),
            other => panic!("'{line}' means {other:?}"),
        }
    }

    #[test]
    fn a_grant_is_made_in_words() {
        let mut robot = Robot::at_work(true);
        does(&mut robot, "grants");
        robot.site_answers(true);
        does(&mut robot, "grant");
        does(&mut robot, "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed");
        for _ in 0..8 {
            if matches!(robot.state.popups.last(), Some(Popup::Confirm(_))) {
                break;
            }
            does(&mut robot, "");
        }
        assert!(matches!(robot.state.popups.last(), Some(Popup::Confirm(_))), "{:?}", robot.state.popups);
        assert!(matches!(meaning(&robot.state, "perhaps"), Meaning::Unknown(_)));
        does(&mut robot, "yes");
        assert_eq!(robot.work().len(), 1);
    }

    #[test]
    fn rows_filters_and_beginnings_of_words() {
        let mut robot = Robot::at_work(true);
        does(&mut robot, "2");
        robot.site_answers(true);
        does(&mut robot, "filter camera");
        assert!(robot.state.row_keys().iter().all(|key| key.contains("camera")));
        assert!(matches!(meaning(&robot.state, "row 1"), Meaning::Row(0)));
        assert!(matches!(meaning(&robot.state, "row /nowhere"), Meaning::Unknown(_)));
        does(&mut robot, "filter");
        assert!(robot.state.row_keys().len() > 1);
        assert!(matches!(meaning(&robot.state, "free"), Meaning::Actions(_)));
        assert!(matches!(meaning(&robot.state, "re"), Meaning::Unknown(text) if text.contains("register")));
        assert!(matches!(meaning(&robot.state, "show"), Meaning::Show));
    }

    #[test]
    fn a_secret_is_known_as_one() {
        let mut robot = Robot::at_work(false);
        assert!(!is_secret(&robot.state));
        does(&mut robot, "create-identity");
        assert!(is_secret(&robot.state));
        does(&mut robot, "esc");
        assert!(robot.state.popups.is_empty());
    }
}
