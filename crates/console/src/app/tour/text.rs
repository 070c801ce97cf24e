//! All texts of the tour. OWNER and READER stand for the names of the two profiles.

/// What a step waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The identity is on the chain.
    Register,
    /// A topic is watched.
    Watch,
    /// A record's path to verified is on screen.
    Verified,
    /// A grant is active.
    Grant,
    /// The reader sees a record of the owner.
    Open,
    /// No grant is active any more.
    Revoke,
    /// Nothing more.
    End,
}

/// The texts of a step: one line each.
#[derive(Debug, Clone, Copy)]
pub struct StepText {
    /// What it waits for.
    pub step: Step,
    /// Its name.
    pub name: &'static str,
    /// What to do.
    pub act: &'static str,
    /// Why.
    pub why: &'static str,
}

/// The steps in their order.
pub const TEXT: [StepText; 7] = [
    StepText {
        step: Step::Register,
        name: "Who you are",
        act: "Press n and type any passphrase twice (this home is temporary).",
        why: "Keys are created here; the chain gets only the public ones.",
    },
    StepText {
        step: Step::Watch,
        name: "Capture a robot",
        act: "Press 2 for topics, select /robot1/odom with the arrows, press w.",
        why: "Each message is encrypted and signed before anyone else sees it.",
    },
    StepText {
        step: Step::Verified,
        name: "See a record verified",
        act: "Press 3 for your records, select one, then enter. esc closes it.",
        why: "Its digest is on the chain: nobody can change it now, not even you.",
    },
    StepText {
        step: Step::Grant,
        name: "Share it",
        act: "esc, 2, g on the topic; address READER. Enter through the form, then y.",
        why: "READER gets the topic's key, sealed. The data itself does not move.",
    },
    StepText {
        step: Step::Open,
        name: "Be the reader",
        act: "Type :profile READER and enter. Then 4, down, enter: a record opens.",
        why: "READER checks digest and signature against the chain before decrypting.",
    },
    StepText {
        step: Step::Revoke,
        name: "Take it back",
        act: "esc, :profile OWNER and enter. Then 5, x on the grant, and y.",
        why: "The next record has a new key. What was already read stays read.",
    },
    StepText {
        step: Step::End,
        name: "That is all",
        act: "Look around: ? lists the keys of a screen. E closes this strip.",
        why: "Just authros opens your own site; the manual starts at docs/README.md.",
    },
];
