//! Targets, and whether a bench reached them. Figures are only figures: `--judge` turns them into an exit code.

use serde::Serialize;

use authros_model::ErrorKind;

/// A figure that must be reached.
#[derive(Debug, Serialize)]
pub struct Target {
    what: String,
    limit: f64,
    /// The figure.
    pub found: f64,
    /// Whether it reached the limit.
    pub ok: bool,
}

impl Target {
    /// An upper limit.
    pub fn at_most(what: impl Into<String>, limit: f64, found: f64) -> Self {
        Self { what: format!("{}, at most", what.into()), limit, found, ok: found <= limit }
    }

    /// A lower limit.
    pub fn at_least(what: impl Into<String>, limit: f64, found: f64) -> Self {
        Self { what: format!("{}, at least", what.into()), limit, found, ok: found >= limit }
    }

    /// One line for each.
    pub fn lines(targets: &[Self]) -> String {
        let line = |target: &Self| {
            let answer = if target.ok { "yes" } else { "NO" };
            format!("{} {:.3}: {answer} ({:.3})", target.what, target.limit, target.found)
        };
        targets.iter().map(line).collect::<Vec<_>>().join("\n")
    }
}

/// The result of comparing a bench's figures with the targets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Judgement {
    /// All targets were reached, or there are none.
    Reached,
    /// A figure missed its target.
    Missed,
    /// Messages were lost, or uploads failed.
    Incomplete,
}

impl Judgement {
    /// Whether every target was reached.
    pub fn of(targets: &[Target]) -> Self {
        if targets.iter().all(|target| target.ok) { Self::Reached } else { Self::Missed }
    }

    /// Whether everything begun was also done.
    pub fn complete(all: bool) -> Self {
        if all { Self::Reached } else { Self::Incomplete }
    }

    /// The exit code with `--judge`.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Reached => 0,
            Self::Missed => ErrorKind::Internal.exit_code(),
            Self::Incomplete => ErrorKind::Incomplete.exit_code(),
        }
    }

    /// The exit code of a bench that ran to its end.
    pub fn ended(self, judge: bool) -> u8 {
        if judge { self.exit_code() } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_an_exit_code_only_if_asked_for() {
        let targets = [Target::at_most("a", 1.0, 0.5), Target::at_least("b", 1.0, 0.5)];
        let all = [Judgement::of(&targets[..1]), Judgement::of(&targets), Judgement::complete(false)];
        assert_eq!(all.map(|one| one.ended(true)), [0, 1, 8]);
        assert_eq!(all.map(|one| one.ended(false)), [0, 0, 0]);
        assert!(Judgement::of(&[Target::at_most("not measured", 1.0, f64::NAN)]) == Judgement::Missed);
        assert_eq!(Target::lines(&targets[1..]), "b, at least 1.000: NO (0.500)");
    }
}
