//! The contract administrator's acts, and what each means.

use strum::IntoStaticStr;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, IntoStaticStr)]
#[strum(serialize_all = "lowercase")]
pub enum Act {
    #[strum(serialize = "allow")]
    Admit,
    Suspend,
    Restore,
    Open,
    Close,
    Pause,
    Continue,
    Propose,
    #[strum(serialize = "deny")]
    Dismiss,
    #[strum(serialize = "nominate")]
    HandOver,
    Accept,
    Deploy,
}

impl Act {
    /// Title, and what the act means.
    pub fn told(self) -> (&'static str, &'static [&'static str]) {
        match self {
            Self::Admit => {
                ("Allow an account to register", &["While registration is closed, only allowed accounts can register."])
            }
            Self::Suspend => (
                "Suspend an account",
                &[
                    "The contract refuses its changes, except those that withdraw rights.",
                    "What it shared stays readable to anyone who has the keys. `restore` undoes this.",
                ],
            ),
            Self::Restore => ("Restore a suspended account", &["The contract accepts its changes again."]),
            Self::Open => ("Open registration?", &["Anyone with an account on this chain can then register."]),
            Self::Close => ("Close registration?", &["Only accounts that you allow can then register."]),
            Self::Pause => (
                "Pause all changes?",
                &["Nobody can register, grant or anchor; revokes and reads still work.", "It ends after a day."],
            ),
            Self::Continue => ("Resume changes?", &["Registrations, grants and anchors are accepted again."]),
            Self::Propose => (
                "Propose the successor of a lost account",
                &[
                    "It waits for the contract's delay, twice as long if the account named no recovery account, which",
                    "can stop it. Then `authros chain succession complete` carries it out, which cannot be undone.",
                ],
            ),
            Self::Dismiss => {
                ("Deny an account", &["The account may no longer register; if it already has, it stays registered."])
            }
            Self::HandOver => (
                "Nominate the next administrator",
                &["Once that account accepts, you are no longer the administrator."],
            ),
            Self::Accept => (
                "Take over as administrator?",
                &["The administrator nominated you; from then on these commands are yours."],
            ),
            Self::Deploy => (
                "Deploy the contract?",
                &["Your account becomes the contract's administrator, and this home is bound to it."],
            ),
        }
    }

    pub fn names(self) -> bool {
        matches!(self, Self::Admit | Self::Dismiss | Self::Suspend | Self::Restore | Self::HandOver | Self::Propose)
    }

    /// Acts that cannot simply be undone: their name must be typed.
    pub fn is_grave(self) -> bool {
        matches!(self, Self::Suspend | Self::HandOver | Self::Pause | Self::Propose)
    }

    pub fn word(self) -> &'static str {
        self.into()
    }
}
