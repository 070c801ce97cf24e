//! One progress line on stderr, if it is a terminal.

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// The least time between two lines.
const PAUSE: Duration = Duration::from_millis(100);
/// Columns that the line may use.
const WIDTH: usize = 78;
/// Columns of the bar.
const BAR: usize = 12;

/// The line. It is erased on drop.
#[derive(Debug)]
pub struct Progress {
    shown: bool,
    begun: Instant,
    last: Option<Instant>,
    what: String,
}

impl Progress {
    /// For a run of that name; silent if stderr is not a terminal.
    pub fn new(what: impl Into<String>) -> Self {
        Self { shown: std::io::stderr().is_terminal(), begun: Instant::now(), last: None, what: what.into() }
    }

    /// This many of all are done.
    pub fn at(&mut self, done: usize, all: usize) {
        let now = Instant::now();
        if !self.shown || self.last.is_some_and(|last| now.duration_since(last) < PAUSE) {
            return;
        }
        self.last = Some(now);
        write(&line(&self.what, done, all, self.begun.elapsed()));
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if self.last.is_some() {
            write("");
        }
    }
}

fn line(what: &str, done: usize, all: usize, gone: Duration) -> String {
    let left = match u32::try_from(done) {
        Ok(done @ 1..) => {
            let whole = gone.checked_div(done).unwrap_or_default();
            let left = whole.saturating_mul(u32::try_from(all).unwrap_or(u32::MAX).saturating_sub(done));
            format!("about {:.0} s left", left.as_secs_f64())
        }
        _ => "waiting".to_owned(),
    };
    let full = done.min(all).saturating_mul(BAR).checked_div(all).unwrap_or(0);
    let bar = format!("{}{}", "#".repeat(full), ".".repeat(BAR - full));
    format!("{what} [{bar}] {done} of {all}, {:.0} s, {left}", gone.as_secs_f64())
}

fn write(text: &str) {
    let mut stderr = std::io::stderr().lock();
    let text: String = text.chars().take(WIDTH).collect();
    let end = if text.is_empty() { "\r" } else { "" };
    // If stderr is closed there is nobody to inform.
    drop(write!(stderr, "\r{text:<WIDTH$}{end}").and_then(|()| stderr.flush()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_follows_from_what_was_done() {
        assert_eq!(line("x", 0, 10, Duration::from_secs(3)), "x [............] 0 of 10, 3 s, waiting");
        assert!(line("x", 3, 0, Duration::ZERO).contains("[............]"));
        assert!(line("x", 30, 20, Duration::ZERO).contains("[############]"));
        assert_eq!(line("x", 5, 20, Duration::from_secs(4)), "x [###.........] 5 of 20, 4 s, about 12 s left");
    }
}
