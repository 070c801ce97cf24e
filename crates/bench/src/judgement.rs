//! Whether a bench reached its targets. Figures are only figures: `--judge` turns them into an exit code.

use authros_model::ErrorKind;

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
    /// Whether every figure reached its target.
    pub fn reached(all: bool) -> Self {
        if all { Self::Reached } else { Self::Missed }
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
    fn figures_are_an_exit_code_only_for_who_asks() {
        let all = [Judgement::reached(true), Judgement::reached(false), Judgement::complete(false)];
        assert_eq!(all.map(|one| one.ended(true)), [0, 1, 8]);
        assert_eq!(all.map(|one| one.ended(false)), [0, 0, 0]);
    }
}
