//! Whether a bench reached what was promised. Figures are figures: only who asks with `--judge` gets it as an exit code.

use authros_model::ErrorKind;

/// What a bench's figures are held to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Judgement {
    /// All that was promised, or nothing was.
    Reached,
    /// A figure missed its mark.
    Missed,
    /// Messages were lost, or uploads failed.
    Incomplete,
}

impl Judgement {
    /// Whether every figure reached its mark.
    pub fn reached(all: bool) -> Self {
        if all { Self::Reached } else { Self::Missed }
    }

    /// Whether everything that was begun was also done.
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
