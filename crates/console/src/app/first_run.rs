//! The first steps of a new profile, with the key for each.

use super::state::State;

/// One step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FirstStep {
    /// Whether it is done.
    pub done: bool,
    /// Its name.
    pub name: &'static str,
    /// The key to press.
    pub key: &'static str,
    /// Its benefit.
    pub text: &'static str,
}

/// The steps while one that matters is open; empty once the profile is set up.
pub fn first_steps(state: &State) -> Vec<FirstStep> {
    let Some(identity) = &state.identity else { return Vec::new() };
    let set_up = identity.exists && identity.registered;
    let step = |done, name, key, text| FirstStep { done, name, key, text };
    let steps = vec![
        match identity.exists {
            true => step(set_up, "identity", "R", "register the identity on the chain"),
            false => step(set_up, "identity", "n", "make keys and register them on the chain"),
        },
        step(identity.exists, "keys", "L", "created with the identity; press L to load your own"),
        step(state.watches(), "topics", "w", "watch a topic: its messages are encrypted and anchored"),
        step(state.grants.any_given() || state.is_locked(), "grant", "g", "let another account read them"),
    ];
    if steps.iter().all(|step| step.done) { Vec::new() } else { steps }
}
