//! Random sequences of calls: mostly such as take effect, often enough such as are refused.

use proptest::collection::vec;
use proptest::prelude::*;

use super::{PEOPLE, WORDS};

/// Which token a call names.
#[derive(Debug, Clone, Copy)]
pub enum Pick {
    Current,
    Fresh,
    Word(u8),
}

/// One step of a sequence; people are places in [`PEOPLE`].
#[derive(Debug, Clone)]
pub enum Step {
    Wait(u64),
    Register { token: Pick, length: usize },
    RotateKeys { token: Pick, key: u8, length: usize },
    Upload { digest: u8, token: Pick, lengths: [usize; 3] },
    Grant { to: usize, back: u64, ends: Option<u64>, topics: usize, envelope: usize },
    Wrap { to: Vec<usize>, back: u64, envelopes: Vec<usize> },
    Revoke { from: usize, token: Pick },
    Rotate { token: Pick },
    Anchor { root: u8, count: u64, previous: Option<u8> },
    Lend { device: u8, ends: Option<u64> },
    Recall { device: u8 },
    Administer { act: Administration, whom: usize, other: usize, yes: bool },
    Accept,
}

/// What the administrator does.
#[derive(Debug, Clone, Copy)]
pub enum Administration {
    Admit,
    SetOpen,
    Suspend,
    Restore,
    SetPaused,
    Succeed,
    Nominate,
}

fn pick() -> impl Strategy<Value = Pick> {
    prop_oneof![3 => Just(Pick::Current), 4 => Just(Pick::Fresh), 2 => (0..WORDS).prop_map(Pick::Word)]
}

/// Mostly `right`, else anything around it.
fn length(right: usize) -> impl Strategy<Value = usize> {
    prop_oneof![12 => Just(right), 1 => Just(right - 1), 1 => Just(right + 1), 1 => Just(0)]
}

fn envelope() -> impl Strategy<Value = usize> {
    prop_oneof![12 => 1usize..70, 1 => Just(0), 1 => Just(4096), 1 => Just(4097)]
}

/// Epochs back from the next one.
fn back() -> impl Strategy<Value = u64> {
    prop_oneof![1 => Just(0u64), 6 => Just(1), 3 => 2u64..4]
}

/// Seconds from now; some ends lie behind when they are given, and some are passed later.
fn ends() -> impl Strategy<Value = Option<u64>> {
    prop_oneof![2 => Just(None), 1 => Just(Some(0)), 4 => (1u64..60).prop_map(Some)]
}

/// Mostly one of the four that register first.
fn person() -> impl Strategy<Value = usize> {
    prop_oneof![8 => 0usize..4, 1 => 4..PEOPLE.len()]
}

fn own_step() -> impl Strategy<Value = Step> {
    let timestamp = prop_oneof![6 => Just(8usize), 1 => Just(0), 1 => Just(32), 1 => Just(33)];
    prop_oneof![
        3 => (pick(), length(224)).prop_map(|(token, length)| Step::Register { token, length }),
        2 => (pick(), any::<u8>(), length(224)).prop_map(|(token, key, length)| Step::RotateKeys { token, key, length }),
        6 => (0..WORDS, pick(), [length(32).boxed(), length(32).boxed(), timestamp.boxed()])
            .prop_map(|(digest, token, lengths)| Step::Upload { digest, token, lengths }),
        8 => (person(), back(), ends(), prop_oneof![3 => Just(0usize), 3 => 1usize..4, 1 => Just(32), 1 => Just(33)], envelope())
            .prop_map(|(to, back, ends, topics, envelope)| Step::Grant { to, back, ends, topics, envelope }),
        6 => (vec(person(), 0..4), back(), vec(envelope(), 0..4))
            .prop_map(|(to, back, envelopes)| Step::Wrap { to, back, envelopes }),
        1 => (31usize..35).prop_map(|many| Step::Wrap { to: vec![0; many], back: 0, envelopes: vec![1; many] }),
        4 => (person(), pick()).prop_map(|(from, token)| Step::Revoke { from, token }),
        3 => pick().prop_map(|token| Step::Rotate { token }),
        5 => (0..WORDS, 0u64..4, prop::option::weighted(0.3, 0..WORDS))
            .prop_map(|(root, count, previous)| Step::Anchor { root, count, previous }),
        3 => (0..WORDS, ends()).prop_map(|(device, ends)| Step::Lend { device, ends }),
        3 => (0..WORDS).prop_map(|device| Step::Recall { device }),
        2 => Just(Step::Accept),
        3 => (0u64..40).prop_map(Step::Wait),
    ]
}

fn administration() -> impl Strategy<Value = Step> {
    use Administration::{Admit, Nominate, Restore, SetOpen, SetPaused, Succeed, Suspend};
    let act = prop_oneof![
        3 => Just(Admit), 2 => Just(SetOpen), 3 => Just(Suspend), 4 => Just(Restore), 3 => Just(SetPaused),
        1 => Just(Succeed), 2 => Just(Nominate),
    ];
    let paused = prop::bool::weighted(0.3);
    (act, person(), person(), paused).prop_map(|(act, whom, other, yes)| Step::Administer { act, whom, other, yes })
}

/// Who takes it, whether it is made to fit (by the administrator or nominee, for one who holds a grant, a device
/// that is lent), and what.
pub type Move = (usize, bool, Step);

/// An open or closed contract, who registers first, and what follows.
pub fn sequence() -> impl Strategy<Value = (bool, usize, Vec<Move>)> {
    let step = prop_oneof![8 => own_step().boxed(), 1 => administration().boxed()];
    let moves = vec((person(), prop::bool::weighted(0.75), step), 1..90);
    (prop::bool::weighted(0.8), prop_oneof![4 => Just(4usize), 1 => 0usize..5], moves)
}
