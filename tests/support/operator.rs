//! An operator at a terminal: presses keys, and waits for what the screen says.

use super::authros::{Authros, Home};
use super::console::{Console, Terminal};
use super::{poll, wait_until};

/// Seconds allowed for anything on a busy machine.
const PATIENCE: u64 = 90;

/// Columns and rows at which a journey is made.
pub const SIZES: [(u16, u16); 3] = [(80, 24), (120, 40), (200, 50)];

pub const PASSPHRASE: &str = "an operator's passphrase";

pub struct Operator(pub Console);

impl Operator {
    /// Opens the console.
    pub fn opens(authros: &Authros, size: (u16, u16)) -> Self {
        Self::runs(authros, size, &[])
    }

    /// Runs a command.
    pub fn runs(authros: &Authros, (columns, rows): (u16, u16), arguments: &[&str]) -> Self {
        Self(Console::open_in(&Terminal::of(columns, rows), authros, arguments))
    }

    fn waits(&mut self, what: &str, holds: impl Fn(&Self) -> bool) -> &mut Self {
        let held = poll(PATIENCE, || holds(self).then_some(()));
        assert!(held.is_some(), "{what}: not within {PATIENCE} s, but:\n{}", self.0.shown());
        self
    }

    pub fn presses(&mut self, keys: &str) -> &mut Self {
        self.0.press(keys);
        self
    }

    pub fn sees(&mut self, text: &str) -> &mut Self {
        self.waits(text, |operator| operator.0.shown().contains(text))
    }

    /// Waits for a line with all of these.
    pub fn sees_row(&mut self, words: &[&str]) -> &mut Self {
        let is_it = |line: &str| words.iter().all(|word| line.contains(word));
        self.waits(&format!("a row with {words:?}"), |operator| operator.0.shown().lines().any(is_it))
    }

    /// Waits for a text that the terminal may have broken anywhere.
    pub fn sees_broken(&mut self, text: &str) -> &mut Self {
        let joined = |text: &str| text.split_whitespace().collect::<String>();
        self.waits(text, |operator| joined(&operator.0.shown()).contains(&joined(text)))
    }

    /// Waits for a text in the popup of that title.
    pub fn reads(&mut self, title: &str, text: &str) -> &mut Self {
        self.waits(&format!("'{text}' in '{title}'"), |operator| operator.popup(title).contains(text))
    }

    pub fn sees_so_often(&mut self, text: &str, times: usize) -> &mut Self {
        self.waits(&format!("'{text}' {times} times"), |operator| operator.0.shown().matches(text).count() >= times)
    }

    pub fn no_longer_sees(&mut self, text: &str) -> &mut Self {
        self.waits(&format!("'{text}' to go"), |operator| !operator.0.shown().contains(text))
    }

    /// The words of the popup of that title as one line; empty if it is not there.
    pub fn popup(&self, title: &str) -> String {
        let shown: Vec<Vec<char>> = self.0.shown().lines().map(|line| line.chars().collect()).collect();
        let head: Vec<char> = format!("┌ {title} ").chars().collect();
        let begins = |line: &Vec<char>| line.windows(head.len()).position(|part| part == head.as_slice());
        let Some((top, left)) = shown.iter().enumerate().find_map(|(row, line)| Some((row, begins(line)?))) else {
            return String::new();
        };
        let width = shown[top][left..].iter().take_while(|sign| **sign != '┐').count();
        let inside = shown[top + 1..].iter().take_while(|line| line.get(left) == Some(&'│'));
        let text: String = inside.flat_map(|line| line[left + 1..].iter().take(width - 1).chain([&' '])).collect();
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    /// Presses keys that are for a row until their effect is seen: they are given up after some seconds without rows.
    pub fn presses_until(&mut self, keys: &str, text: &str) -> &mut Self {
        wait_until(PATIENCE, &format!("'{text}' after {keys:?}"), || {
            self.0.press(keys);
            poll(5, || self.0.shown().contains(text).then_some(()))
        });
        self
    }

    /// Takes the filter away: a message on the screen goes first.
    pub fn clears_the_filter(&mut self) -> &mut Self {
        wait_until(PATIENCE, "the filter to go", || {
            self.0.press("\u{1b}");
            poll(1, || (!self.0.shown().contains("filter:")).then_some(()))
        });
        self
    }

    /// Quits, even while records are pending.
    pub fn leaves(&mut self) {
        self.presses("\u{3}");
        let gone = |operator: &mut Self| {
            operator.0.has_ended() || operator.0.shown().contains("Quit?") && operator.presses("y").0.has_ended()
        };
        wait_until(PATIENCE, "the console to end", || Some(()).filter(|()| gone(self)));
        self.0.expect_restored();
    }

    pub fn is_gone(&mut self) {
        wait_until(PATIENCE, "the console to end", || Some(()).filter(|()| self.0.has_ended()));
        self.0.expect_restored();
    }
}

/// A profile with a keyring that only its operator can open, and one robot.
pub fn locked_profile(home: &Home) -> Authros {
    let authros = home.authros().with(&["--robots", "1"]);
    let passphrase = home.file("passphrase", PASSPHRASE, 0o600);
    authros.with(&["--passphrase-file", &passphrase]).enrol();
    authros
}
